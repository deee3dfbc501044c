// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "kernels/aligned.h"

namespace downpour {

// Shape of a network with one hidden layer (paper section IV-A2).
struct MlpShape {
  int n_inputs = 0;
  int n_hidden = 0;
  int n_outputs = 0;
  int n_parameters() const { return (n_inputs + 1) * n_hidden + (n_hidden + 1) * n_outputs; }
};

// outputs = limit tanh(W1 tanh(W0 (input_scale x) + b0) + b1) for a tile of lanes that each have
// their own parameters.
//   parameters   n_parameters x kTileLanes in the order W0 (n_hidden x n_inputs, row-major), b0, W1
//                (n_outputs x n_hidden, row-major), b1
//   input_scale  (n_inputs) factors; limits (n_outputs)
//   inputs       n_inputs x kTileLanes; outputs n_outputs x kTileLanes
// Tile arrays are aligned and do not alias. |output| <= limit. Thread-safe, does not allocate.
void MlpTile(const MlpShape& shape, const double* parameters, const double* input_scale,
             const double* limits, const double* inputs, double* outputs);

}  // namespace downpour
