// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

namespace downpour {

// QueryCovariances and QueryVariances (kernels/dense_query/dense_query.h) for one query in long
// double: `query` (D) against one point (D), and one query's column of V (n), not clamped.
template <typename T>
long double QueryCovarianceRef(int dim, const T* query, const T* point) {
  long double exponent = 0;
  for (int d = 0; d < dim; ++d) {
    const long double delta = static_cast<long double>(query[d]) - point[d];
    exponent += delta * delta;
  }
  return std::exp2(-exponent);
}

template <typename T>
long double QueryVarianceRef(int n, double signal_variance, const T* v) {
  long double variance = signal_variance;
  for (int i = 0; i < n; ++i) variance -= static_cast<long double>(v[i]) * v[i];
  return variance;
}

}  // namespace downpour
