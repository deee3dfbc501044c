// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "kernels/aligned.h"

namespace downpour {

struct LinearPolicyShape {
  int n_inputs = 0;
  int n_outputs = 0;
  int n_parameters() const { return (n_inputs + 1) * n_outputs; }
};

// outputs = limit kappa(W (input_scale x) + b) for a tile of lanes that each have their own
// parameters; kappa(a) = 9/8 sin a + 1/8 sin 3a (kernels/squash).
//   parameters   n_parameters x kTileLanes in the order W (n_outputs x n_inputs, row-major), b
//   input_scale  (n_inputs) factors; limits (n_outputs)
//   inputs       n_inputs x kTileLanes; outputs n_outputs x kTileLanes
// Lanes from n_lanes on, rounded up to whole vectors, are left as they are.
// Tile arrays are aligned and do not alias. |output| <= limit. Thread-safe, does not allocate.
void LinearPolicyTile(const LinearPolicyShape& shape, int n_lanes, const double* parameters,
                      const double* input_scale, const double* limits, const double* inputs,
                      double* outputs);

}  // namespace downpour
