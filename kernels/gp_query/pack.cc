// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "kernels/gp_query/gp_query.h"
#include "kernels/gp_query/triangle_layout.h"

namespace downpour {
namespace {

// Scales, centre and points.
template <typename T>
void PackInputs(const GpPosterior& posterior, GpFactorT<T>* f) {
  const std::size_t dim = f->dim;
  f->scale.resize(dim);
  f->centre.assign(dim, 0.0);
  f->inputs.assign(f->n_padded * dim, T(0));
  for (std::size_t k = 0; k < dim; ++k) {
    f->scale[k] = std::sqrt(0.5 * std::numbers::log2e) / posterior.lengthscales[k];
    for (int i = 0; i < f->n; ++i) {
      f->centre[k] += f->scale[k] * posterior.inputs[i * dim + k] / f->n;
    }
    for (int i = 0; i < f->n; ++i) {
      const double q = std::fma(f->scale[k], posterior.inputs[i * dim + k], -f->centre[k]);
      f->inputs[PointOffset(i, k, f->dim)] = static_cast<T>(q);
    }
  }
}

// V as the kernel will use it, rounded to T and back (row-major, n x kRowBlock): what the weights
// are multiplied by must be what e is divided by.
template <typename T>
std::vector<double> PackDeflation(const double* deflation, GpFactorT<T>* f) {
  f->deflation.assign(static_cast<std::size_t>(f->n_padded) * kRowBlock, T(0));
  std::vector<double> rounded(static_cast<std::size_t>(f->n) * kRowBlock);
  for (int j = 0; j < f->n; ++j) {
    for (int i = 0; i < std::min(j + 1, kRowBlock); ++i) {
      const double v = deflation[static_cast<std::size_t>(i) * f->n + j];
      T& packed = f->deflation[PointOffset(j, i, kRowBlock)];
      packed = static_cast<T>(i == j ? 1 / v : v);
      rounded[static_cast<std::size_t>(j) * kRowBlock + i] = i == j ? 1.0 / packed : packed;
    }
  }
  return rounded;
}

// Replaces the first kRowBlock of a row's n values by row V, those of e by those of e'.
void DeflateRow(const std::vector<double>& v, int n, double* row) {
  double deflated[kRowBlock] = {};
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < kRowBlock; ++i) deflated[i] += row[j] * v[j * kRowBlock + i];
  }
  std::copy_n(deflated, kRowBlock, row);
}

}  // namespace

template <typename T>
GpFactorT<T> PackGpFactor(const GpPosterior& posterior) {
  const int n = posterior.n;
  GpFactorT<T> f;
  f.n = n;
  f.dim = posterior.dim;
  f.n_padded = (n + kRowBlock - 1) / kRowBlock * kRowBlock;
  f.signal_variance = posterior.signal_std * posterior.signal_std;
  f.noise_variance = posterior.noise_std * posterior.noise_std;
  PackInputs(posterior, &f);
  std::vector<double> v;
  if (posterior.deflation != nullptr) v = PackDeflation(posterior.deflation, &f);
  // A row of W or the weights in double.
  const auto finish_row = [&](double* row) {
    for (int j = 0; j < n; ++j) row[j] *= f.signal_variance;
    if (!v.empty()) DeflateRow(v, n, row);
  };
  std::vector<double> row(posterior.weights, posterior.weights + n);
  finish_row(row.data());
  f.weights.assign(f.n_padded, T(0));
  std::copy_n(row.data(), n, f.weights.data());
  // W row-major, padded.
  const std::size_t side = f.n_padded;
  std::vector<double> w(side * side, 0.0);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j <= i; ++j) w[i * side + j] = posterior.inverse_factor[j * std::size_t(n) + i];
    finish_row(w.data() + i * side);
  }
  f.triangle.reserve(side * (side + kRowBlock) / 2);
  ForEachChunk(f.n_padded, [&](const TriangleChunk& chunk) {
    for (int first = chunk.row; first < chunk.end_row; first += kRowBlock) {
      for (int j = chunk.column; j < chunk.column + chunk.Columns(first); ++j) {
        for (int i = first; i < first + kRowBlock; ++i) {
          f.triangle.push_back(static_cast<T>(w[i * side + j]));
        }
      }
    }
  });
  return f;
}

template GpFactor PackGpFactor<double>(const GpPosterior&);
template GpFactor32 PackGpFactor<float>(const GpPosterior&);

}  // namespace downpour
