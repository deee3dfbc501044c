// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "kernels/movement_primitive/movement_primitive.h"
#include "kernels/squash/squash_ref.h"

namespace downpour {

// Scalar long-double twin of MovementPrimitiveTile for one lane: parameters (n_outputs n_weights).
inline std::vector<long double> MovementPrimitiveReference(int n_weights, int n_outputs,
                                                           const double* response,
                                                           const double* parameters,
                                                           const double* limits) {
  std::vector<long double> outputs(n_outputs);
  for (int o = 0; o < n_outputs; ++o) {
    long double sum = 0;
    for (int i = 0; i < n_weights; ++i) {
      sum += static_cast<long double>(response[i]) * parameters[o * n_weights + i];
    }
    outputs[o] = limits[o] * SquashReference(sum);
  }
  return outputs;
}

}  // namespace downpour
