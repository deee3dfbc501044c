// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstddef>
#include <numbers>

#include "kernels/gp_query/gp_query.h"
#include "kernels/gp_query/triangle_layout.h"

namespace downpour {
namespace {

// Scales, centre and points.
template <typename T>
void PackInputs(const double* inputs, const double* lengthscales, GpFactorT<T>* f) {
  const std::size_t dim = f->dim;
  f->scale.resize(dim);
  f->centre.assign(dim, 0.0);
  f->inputs.assign(f->n_padded * dim, T(0));
  for (std::size_t k = 0; k < dim; ++k) {
    f->scale[k] = std::sqrt(0.5 * std::numbers::log2e) / lengthscales[k];
    for (int i = 0; i < f->n; ++i) f->centre[k] += f->scale[k] * inputs[i * dim + k] / f->n;
    for (int i = 0; i < f->n; ++i) {
      const double q = std::fma(f->scale[k], inputs[i * dim + k], -f->centre[k]);
      f->inputs[i * dim + k] = static_cast<T>(q);
    }
  }
}

}  // namespace

template <typename T>
GpFactorT<T> PackGpFactorT(int n, int dim, const double* inputs, const double* lengthscales,
                           double signal_std, double noise_std, const double* weights,
                           const double* inverse_factor) {
  GpFactorT<T> f;
  f.n = n;
  f.dim = dim;
  f.n_padded = (n + kRowBlock - 1) / kRowBlock * kRowBlock;
  f.signal_variance = signal_std * signal_std;
  f.noise_variance = noise_std * noise_std;
  PackInputs(inputs, lengthscales, &f);
  f.weights.assign(f.n_padded, T(0));
  for (int i = 0; i < n; ++i) f.weights[i] = static_cast<T>(f.signal_variance * weights[i]);
  f.triangle.reserve(static_cast<std::size_t>(f.n_padded) * (f.n_padded + kRowBlock) / 2);
  ForEachChunk(f.n_padded, [&](const TriangleChunk& chunk) {
    for (int row = chunk.row; row < chunk.end_row; row += kRowBlock) {
      for (int j = chunk.column; j < chunk.column + chunk.Columns(row); ++j) {
        for (int i = row; i < row + kRowBlock; ++i) {
          const std::size_t at = static_cast<std::size_t>(j) * n + i;
          const double w = i < n && j <= i ? f.signal_variance * inverse_factor[at] : 0.0;
          f.triangle.push_back(static_cast<T>(w));
        }
      }
    }
  });
  return f;
}

template GpFactor PackGpFactorT<double>(int, int, const double*, const double*, double, double,
                                        const double*, const double*);
template GpFactor32 PackGpFactorT<float>(int, int, const double*, const double*, double, double,
                                         const double*, const double*);

}  // namespace downpour
