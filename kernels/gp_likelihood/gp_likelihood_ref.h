// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

namespace downpour {

using LongRows = std::vector<std::vector<long double>>;

// L (lower triangle) with L L^T = K.
inline LongRows CholeskyReference(const LongRows& k) {
  LongRows l = k;
  for (std::size_t i = 0; i < k.size(); ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      for (std::size_t m = 0; m < j; ++m) l[i][j] -= l[i][m] * l[j][m];
      l[i][j] = i == j ? std::sqrt(l[i][i]) : l[i][j] / l[j][j];
    }
  }
  return l;
}

// (L L^T)^-1, a column at a time by two substitutions.
inline LongRows InverseReference(const LongRows& l) {
  const std::size_t n = l.size();
  LongRows inverse(n, std::vector<long double>(n));
  for (std::size_t column = 0; column < n; ++column) {
    std::vector<long double>& x = inverse[column];
    x[column] = 1;
    for (std::size_t i = column; i < n; ++i) {
      for (std::size_t m = column; m < i; ++m) x[i] -= l[i][m] * x[m];
      x[i] /= l[i][i];
    }
    for (std::size_t i = n; i-- > 0;) {
      for (std::size_t m = i + 1; m < n; ++m) x[i] -= l[m][i] * x[m];
      x[i] /= l[i][i];
    }
  }
  return inverse;
}

// GpLikelihood (kernels/gp_likelihood/gp_likelihood.h) in long double, entry by entry, and what its
// error bounds need.
struct GpLikelihoodReference {
  long double value = 0;
  long double value_magnitude = 0;  // y^T K^-1 y + n
  std::vector<long double> gradient;
  std::vector<long double> magnitude;  // sum of the absolute values of the gradient's terms
};

inline GpLikelihoodReference LikelihoodReference(int n, int dim, const double* scaled, int ld,
                                                 const double* targets, double signal_variance,
                                                 double noise_variance) {
  const auto square = [&](int d, int i, int j) {
    const double* const x = scaled + static_cast<std::size_t>(d) * ld;
    const long double delta = static_cast<long double>(x[i]) - x[j];
    return delta * delta;
  };
  LongRows noise_free(n, std::vector<long double>(n));
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      long double distance = 0;
      for (int d = 0; d < dim; ++d) distance += square(d, i, j);
      noise_free[i][j] = signal_variance * std::exp(-distance / 2);
    }
  }
  LongRows k = noise_free;
  for (int i = 0; i < n; ++i) k[i][i] += noise_variance;
  const LongRows l = CholeskyReference(k), inverse = InverseReference(l);
  std::vector<long double> alpha(n);
  GpLikelihoodReference out;
  out.value = -n * std::log(2 * std::numbers::pi_v<long double>) / 2;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) alpha[i] += inverse[i][j] * targets[j];
    out.value -= targets[i] * alpha[i] / 2 + std::log(l[i][i]);
    out.value_magnitude += targets[i] * alpha[i] + 1;
  }
  out.gradient.resize(dim + 2);
  out.magnitude.resize(dim + 2);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      for (int p = 0; p < dim + 2; ++p) {
        const long double derivative = p < dim    ? noise_free[i][j] * square(p, i, j)
                                       : p == dim ? 2 * noise_free[i][j]
                                                  : (i == j ? 2.0L * noise_variance : 0);
        const long double product = alpha[i] * alpha[j];
        out.gradient[p] += (product - inverse[i][j]) * derivative / 2;
        out.magnitude[p] += (std::abs(product) + std::abs(inverse[i][j])) * derivative;
      }
    }
  }
  return out;
}

}  // namespace downpour
