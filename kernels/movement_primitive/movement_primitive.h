// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "kernels/aligned.h"

namespace downpour {

// One step of movement primitives, one an action, for a tile of lanes that each have their own
// parameters: outputs[o] = limit_o kappa(sum_i response_i theta_oi), kappa(a) = 9/8 sin a +
// 1/8 sin 3a (kernels/squash).
//   response    (n_weights) what a parameter of 1 adds to the primitive's output at this step
//   parameters  n_outputs n_weights x kTileLanes, the weights of one output after the other
//   limits      (n_outputs); outputs n_outputs x kTileLanes
// Lanes from n_lanes on, rounded up to whole vectors, are left as they are.
// Tile arrays are aligned and do not alias. |output| <= limit. Thread-safe, does not allocate.
void MovementPrimitiveTile(int n_weights, int n_outputs, int n_lanes, const double* response,
                           const double* parameters, const double* limits, double* outputs);

}  // namespace downpour
