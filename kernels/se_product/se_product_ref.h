// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "kernels/se_product/se_product.h"

namespace downpour {

struct SeProductReference {
  std::vector<long double> rows, columns, moments;  // (n), (n), n x dim
  // The same sums of absolute values, and the largest |u_i| + |v_j| + |p_i| . |b_j|.
  std::vector<long double> row_sizes, column_sizes, moment_sizes;
  long double exponent_size = 0;
};

// Scalar long-double twin of SeProductSums.
inline SeProductReference ReferenceSeProduct(const SeProduct& x) {
  SeProductReference result;
  for (auto* sums : {&result.rows, &result.columns, &result.row_sizes, &result.column_sizes}) {
    sums->assign(x.n, 0);
  }
  result.moments.assign(x.n * x.dim, 0);
  result.moment_sizes.assign(x.n * x.dim, 0);
  for (int i = 0; i < x.n; ++i) {
    for (int j = 0; j < x.n; ++j) {
      long double weight = 0;
      if (x.weights == nullptr) {
        weight = static_cast<long double>(x.row_weights[i]) * x.column_weights[j];
      } else if (j <= i) {
        weight = x.weights[i * x.ld + j];
      } else {
        continue;
      }
      long double s = static_cast<long double>(x.u[i]) + x.v[j];
      long double size = std::abs(x.u[i]) + std::abs(x.v[j]);
      for (int d = 0; d < x.dim; ++d) {
        const long double product =
            static_cast<long double>(x.p[i * x.dim + d]) * x.b[d * x.ld + j];
        s += product;
        size += std::abs(product);
      }
      const long double n = weight * std::exp2(-std::max(0.0L, s));
      result.exponent_size = std::max(result.exponent_size, size);
      result.rows[i] += n;
      result.columns[j] += n;
      result.row_sizes[i] += std::abs(n);
      result.column_sizes[j] += std::abs(n);
      for (int d = 0; d < x.dim; ++d) {
        result.moments[i * x.dim + d] += n * x.b[d * x.ld + j];
        result.moment_sizes[i * x.dim + d] += std::abs(n * x.b[d * x.ld + j]);
      }
    }
  }
  return result;
}

}  // namespace downpour
