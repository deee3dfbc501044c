// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <vector>

#include "kernels/gp_query/gp_query.h"

namespace downpour {

// Scalar long-double twin of GpQueryTile for one query x (D), and what its error bounds need.
struct GpQueryReference {
  long double mean = 0;
  long double variance = 0;       // not clamped
  long double mean_absolute = 0;  // sum |weights_i| e_i (1 + exponent_i): scale of the mean's error
  long double norm_absolute = 0;  // sum_r |(We)_r| sum_j |W_rj| e_j (1 + exponent_j)
};

inline GpQueryReference QueryReference(const GpFactor& f, const double* x) {
  GpQueryReference out;
  std::vector<long double> e(f.n_padded), spread(f.n_padded);
  for (int i = 0; i < f.n_padded; ++i) {
    long double exponent = 0;
    long double magnitude = 0;  // terms of |s x - s x_i|^2 before their cancellation
    for (int k = 0; k < f.dim; ++k) {
      const long double a = static_cast<long double>(f.scale[k]) * x[k];
      const long double b = f.inputs[i * f.dim + k];
      exponent += (a - b) * (a - b);
      magnitude += std::abs(a - b) * (std::abs(a) + std::abs(b));
    }
    e[i] = std::exp(-exponent);
    spread[i] = e[i] * (1 + exponent + magnitude);
    out.mean += f.weights[i] * e[i];
    out.mean_absolute += std::abs(f.weights[i]) * spread[i];
  }
  const double* w = f.triangle.data();
  long double norm = 0;
  for (int first = 0; first < f.n_padded; first += GpFactor::kRowBlock) {
    const int columns = first + GpFactor::kRowBlock;
    for (int r = 0; r < GpFactor::kRowBlock; ++r) {
      long double dot = 0, absolute = 0;
      for (int j = 0; j < columns; ++j) {
        const long double wj = w[j * GpFactor::kRowBlock + r];
        dot += wj * e[j];
        absolute += std::abs(wj) * spread[j];
      }
      norm += dot * dot;
      out.norm_absolute += std::abs(dot) * absolute;
    }
    w += GpFactor::kRowBlock * columns;
  }
  out.variance = f.signal_variance - norm;
  return out;
}

}  // namespace downpour
