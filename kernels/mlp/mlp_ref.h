// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <vector>

#include "kernels/mlp/mlp.h"

namespace downpour {

// Scalar long-double twin of MlpTile for one lane: parameters (n_parameters), inputs (n_inputs).
inline std::vector<long double> MlpReference(const MlpShape& shape, const double* parameters,
                                             const double* input_scale, const double* limits,
                                             const double* inputs) {
  const double* b0 = parameters + shape.n_hidden * shape.n_inputs;
  const double* w1 = b0 + shape.n_hidden;
  const double* b1 = w1 + shape.n_outputs * shape.n_hidden;
  std::vector<long double> hidden(shape.n_hidden), outputs(shape.n_outputs);
  for (int h = 0; h < shape.n_hidden; ++h) {
    long double sum = b0[h];
    for (int i = 0; i < shape.n_inputs; ++i) {
      sum +=
          static_cast<long double>(parameters[h * shape.n_inputs + i]) * input_scale[i] * inputs[i];
    }
    hidden[h] = std::tanh(sum);
  }
  for (int o = 0; o < shape.n_outputs; ++o) {
    long double sum = b1[o];
    for (int h = 0; h < shape.n_hidden; ++h) sum += w1[o * shape.n_hidden + h] * hidden[h];
    outputs[o] = limits[o] * std::tanh(sum);
  }
  return outputs;
}

}  // namespace downpour
