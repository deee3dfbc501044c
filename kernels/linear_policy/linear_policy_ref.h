// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "kernels/linear_policy/linear_policy.h"
#include "kernels/squash/squash_ref.h"

namespace downpour {

// Scalar long-double twin of LinearPolicyTile for one lane: parameters (n_parameters), inputs
// (n_inputs).
inline std::vector<long double> LinearPolicyReference(const LinearPolicyShape& shape,
                                                      const double* parameters,
                                                      const double* input_scale,
                                                      const double* limits, const double* inputs) {
  std::vector<long double> outputs(shape.n_outputs);
  for (int o = 0; o < shape.n_outputs; ++o) {
    long double sum = parameters[shape.n_outputs * shape.n_inputs + o];
    for (int i = 0; i < shape.n_inputs; ++i) {
      sum +=
          static_cast<long double>(parameters[o * shape.n_inputs + i]) * input_scale[i] * inputs[i];
    }
    outputs[o] = limits[o] * SquashReference(sum);
  }
  return outputs;
}

}  // namespace downpour
