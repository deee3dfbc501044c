// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
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
  long double mean_absolute = 0;  // scales of the errors of the mean
  long double norm_absolute = 0;  // and of |W e|^2
};

// e and b of gp_query.h for one query, and after Deflate e' in the place of e.
struct CovarianceReference {
  std::vector<long double> e, b;
};

template <typename T>
CovarianceReference ReferenceCovariances(const GpFactorT<T>& f, const double* x) {
  CovarianceReference out{std::vector<long double>(f.n_padded),
                          std::vector<long double>(f.n_padded)};
  for (int i = 0; i < f.n_padded; ++i) {
    long double exponent = 0;
    long double magnitude = 0;  // terms of |s x - s x_i|^2 before their cancellation
    for (int k = 0; k < f.dim; ++k) {
      const long double scaled = static_cast<long double>(f.scale[k]) * x[k];
      const long double a = scaled - f.centre[k];
      const long double p = f.inputs[PointOffset(i, k, f.dim)];
      exponent += (a - p) * (a - p);
      magnitude += std::abs(a - p) * (std::abs(a) + std::abs(p) + std::abs(scaled));
    }
    out.e[i] = std::exp2(-exponent);
    out.b[i] = out.e[i] * (1 + exponent + magnitude);
  }
  return out;
}

template <typename T>
void Deflate(const GpFactorT<T>& f, CovarianceReference* c) {
  for (int i = 0; i < f.n_padded; ++i) {
    const auto v = [&](int k) { return f.deflation[PointOffset(i, k, kRowBlock)]; };
    for (int k = 0; k < std::min(i, kRowBlock); ++k) {
      c->e[i] -= v(k) * c->e[k];
      c->b[i] += std::abs(v(k) * c->e[k]);
    }
    if (i < kRowBlock) c->e[i] *= v(i);
  }
}

// A row of W from that of W', in place: W' V^-1.
template <typename T>
void Undeflate(const GpFactorT<T>& f, std::vector<long double>* row) {
  for (int k = kRowBlock - 1; k >= 0; --k) {
    for (int i = k + 1; i < f.n_padded; ++i) {
      (*row)[k] -= (*row)[i] * f.deflation[PointOffset(i, k, kRowBlock)];
    }
    (*row)[k] *= f.deflation[PointOffset(k, k, kRowBlock)];
  }
}

// W row by row, n_padded x n_padded.
template <typename T>
std::vector<std::vector<long double>> UnpackTriangle(const GpFactorT<T>& f) {
  std::vector<std::vector<long double>> rows(f.n_padded, std::vector<long double>(f.n_padded));
  ForEachChunk(f.n_padded, [&](const TriangleChunk& chunk) {
    const T* w = f.triangle.data() + chunk.offset;
    for (int row = chunk.row; row < chunk.end_row; row += kRowBlock) {
      for (int j = chunk.column; j < chunk.column + chunk.Columns(row); ++j) {
        for (int r = row; r < row + kRowBlock; ++r) rows[r][j] = *w++;
      }
    }
  });
  return rows;
}

template <typename T>
GpQueryReference QueryReference(const GpFactorT<T>& f, const double* x) {
  const bool deflated = !f.deflation.empty();
  CovarianceReference c = ReferenceCovariances(f, x);
  if (deflated) Deflate(f, &c);
  GpQueryReference out;
  // Returns row e and adds its error's scale to `absolute`.
  const auto apply = [&](std::vector<long double> row, long double* absolute) {
    long double sum = 0;
    for (int j = 0; j < f.n_padded; ++j) {
      sum += row[j] * c.e[j];
      if (deflated) *absolute += std::abs(row[j] * c.e[j]);
    }
    if (deflated) Undeflate(f, &row);
    for (int j = 0; j < f.n_padded; ++j) *absolute += std::abs(row[j]) * c.b[j];
    return sum;
  };
  out.mean = apply({f.weights.begin(), f.weights.end()}, &out.mean_absolute);
  out.variance = f.signal_variance;
  for (const std::vector<long double>& row : UnpackTriangle(f)) {
    long double absolute = 0;
    const long double sum = apply(row, &absolute);
    out.variance -= sum * sum;
    out.norm_absolute += std::abs(sum) * absolute;
  }
  return out;
}

}  // namespace downpour
