// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "kernels/gp_query/gp_query.h"
#include "kernels/gp_query/triangle_layout.h"

namespace downpour {

// Scalar long-double twin of GpQueryTile for one query x (D), and what its error bounds need.
struct GpQueryReference {
  long double mean = 0;
  long double variance = 0;       // not clamped
  long double mean_absolute = 0;  // sum_i |weights_i| e'_i: scale of the mean's error
  long double norm_absolute = 0;  // sum_r |(W e)_r| sum_j |W_rj| e'_j
};

template <typename T>
GpQueryReference QueryReference(const GpFactorT<T>& f, const double* x) {
  GpQueryReference out;
  std::vector<long double> e(f.n_padded), spread(f.n_padded);
  for (int i = 0; i < f.n_padded; ++i) {
    long double exponent = 0;
    long double magnitude = 0;  // terms of |s x - s x_i|^2 before their cancellation
    for (int k = 0; k < f.dim; ++k) {
      const long double scaled = static_cast<long double>(f.scale[k]) * x[k];
      const long double a = scaled - f.centre[k];
      const long double b = f.inputs[i * f.dim + k];
      exponent += (a - b) * (a - b);
      magnitude += std::abs(a - b) * (std::abs(a) + std::abs(b) + std::abs(scaled));
    }
    e[i] = std::exp2(-exponent);
    spread[i] = e[i] * (1 + exponent + magnitude);
    out.mean += f.weights[i] * e[i];
    out.mean_absolute += std::abs(f.weights[i]) * spread[i];
  }
  std::vector<long double> rows(f.n_padded), absolute(f.n_padded);
  ForEachChunk(f.n_padded, [&](const TriangleChunk& chunk) {
    const T* w = f.triangle.data() + chunk.offset;
    for (int row = chunk.row; row < chunk.end_row; row += kRowBlock) {
      for (int j = chunk.column; j < chunk.column + chunk.Columns(row); ++j) {
        for (int r = row; r < row + kRowBlock; ++r, ++w) {
          const long double wrj = *w;
          rows[r] += wrj * e[j];
          absolute[r] += std::abs(wrj) * spread[j];
        }
      }
    }
  });
  out.variance = f.signal_variance;
  for (int r = 0; r < f.n_padded; ++r) {
    out.variance -= rows[r] * rows[r];
    out.norm_absolute += std::abs(rows[r]) * absolute[r];
  }
  return out;
}

}  // namespace downpour
