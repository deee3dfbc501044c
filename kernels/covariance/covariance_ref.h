// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace downpour {

// Scalar twins in long double; `size` receives the sums of the terms' absolute values, which scale
// the rounding errors.
inline long double TriangularProductReference(int n, const double* l, const double* z, int row,
                                              int column, long double* size) {
  long double sum = 0;
  *size = 0;
  for (int k = 0; k <= row; ++k) {
    const long double term = static_cast<long double>(l[row + std::ptrdiff_t{k} * n]) *
                             z[k + std::ptrdiff_t{column} * n];
    sum += term;
    *size += term < 0 ? -term : term;
  }
  return sum;
}

inline long double SymmetricProductReference(int n, int k, double decay, const double* weights,
                                             const double* a, double c, int row, int column,
                                             long double* size) {
  long double sum = static_cast<long double>(decay) * c;
  *size = sum < 0 ? -sum : sum;
  for (int i = 0; i < k; ++i) {
    const long double term = static_cast<long double>(weights[i]) * a[row + std::ptrdiff_t{i} * n] *
                             a[column + std::ptrdiff_t{i} * n];
    sum += term;
    *size += term < 0 ? -term : term;
  }
  return sum;
}

}  // namespace downpour
