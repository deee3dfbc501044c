// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "kernels/mlp/mlp.h"

namespace downpour {

// Scalar long-double twin of MlpTile for one lane: parameters (n_parameters), inputs (n_inputs).
inline std::vector<long double> MlpReference(const MlpShape& shape, const double* parameters,
                                             const double* input_scale, const double* limits,
                                             const double* inputs) {
  std::vector<long double> y(shape.n_inputs());
  for (int i = 0; i < shape.n_inputs(); ++i) {
    y[i] = static_cast<long double>(input_scale[i]) * inputs[i];
  }
  for (std::size_t l = 1; l < shape.units.size(); ++l) {
    const int n_before = shape.units[l - 1], n_units = shape.units[l];
    const double* const b = parameters + n_before * n_units;
    std::vector<long double> next(n_units);
    for (int o = 0; o < n_units; ++o) {
      long double sum = b[o];
      for (int i = 0; i < n_before; ++i) sum += parameters[o * n_before + i] * y[i];
      const bool relu = shape.activation == Activation::kRelu && l + 1 < shape.units.size();
      next[o] = relu ? (sum > 0 ? sum : 0) : std::tanh(sum);
    }
    parameters = b + n_units;
    y = std::move(next);
  }
  for (int o = 0; o < shape.n_outputs(); ++o) y[o] *= limits[o];
  return y;
}

}  // namespace downpour
