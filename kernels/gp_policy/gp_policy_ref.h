// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <vector>

#include "kernels/gp_policy/gp_policy.h"
#include "kernels/squash/squash_ref.h"

namespace downpour {

struct GpPolicyReference {
  std::vector<long double> output;      // (n_outputs)
  std::vector<long double> alpha_norm;  // (n_outputs) |alpha|
};

// Scalar long-double twin of GpPolicyPrepareTile and GpPolicyTile for one lane: parameters
// (n_parameters), inputs (n_inputs).
inline GpPolicyReference ReferenceGpPolicy(const GpPolicyShape& shape, const double* parameters,
                                           const double* input_scale, const double* limits,
                                           const double* inputs) {
  const int n = shape.n_points, dim = shape.n_inputs;
  GpPolicyReference result;
  for (int o = 0; o < shape.n_outputs; ++o) {
    const double* targets = parameters + n * dim + o * n;
    const double* log_lengthscales = parameters + n * dim + shape.n_outputs * n + o * dim;
    const auto covariance = [&](const auto& x, const double* z) {
      long double distance = 0;
      for (int f = 0; f < dim; ++f) {
        const long double difference =
            (x(f) - z[f]) / std::exp(static_cast<long double>(log_lengthscales[f]));
        distance += difference * difference;
      }
      return std::exp(-distance / 2);
    };
    // Gaussian elimination of [K + noise I | p]: no pivots, as the matrix is positive definite.
    std::vector<std::vector<long double>> rows(n, std::vector<long double>(n + 1));
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        const double* z = parameters + i * dim;
        rows[i][j] = covariance([&](int f) -> long double { return z[f]; }, parameters + j * dim);
      }
      rows[i][i] += static_cast<long double>(kGpPolicyNoise);
      rows[i][n] = targets[i];
    }
    for (int k = 0; k < n; ++k) {
      for (int i = 0; i < n; ++i) {
        if (i == k) continue;
        const long double factor = rows[i][k] / rows[k][k];
        for (int j = k; j <= n; ++j) rows[i][j] -= factor * rows[k][j];
      }
    }
    long double mean = 0, norm = 0;
    for (int i = 0; i < n; ++i) {
      const long double alpha = rows[i][n] / rows[i][i];
      const auto scaled = [&](int f) {
        return static_cast<long double>(input_scale[f]) * inputs[f];
      };
      mean += alpha * covariance(scaled, parameters + i * dim);
      norm += alpha * alpha;
    }
    result.output.push_back(limits[o] * SquashReference(mean));
    result.alpha_norm.push_back(std::sqrt(norm));
  }
  return result;
}

}  // namespace downpour
