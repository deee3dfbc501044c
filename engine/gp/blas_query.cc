// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/blas_query.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "engine/gp/compression.h"
#include "engine/lapack.h"
#include "engine/single_threaded_blas.h"
#include "kernels/dense_query/dense_query.h"

namespace downpour {
namespace {

// s_d x_d - c_d of all tiles, D rows of n_tiles kTileLanes.
void ScaleQueries(const BlasFactor& f, int n_tiles, std::size_t stride, const double* x,
                  double* queries) {
  for (int d = 0; d < f.dim; ++d) {
    const double scale = f.scale[d], centre = f.centre[d];
    for (int tile = 0; tile < n_tiles; ++tile, queries += kTileLanes) {
      const double* const from = x + tile * stride + d * kTileLanes;
      for (int lane = 0; lane < kTileLanes; ++lane) queries[lane] = scale * from[lane] - centre;
    }
  }
}

void CopyToTiles(const double* from, int n_tiles, std::size_t stride, double* to) {
  for (int tile = 0; tile < n_tiles; ++tile) {
    std::copy_n(from + tile * kTileLanes, kTileLanes, to + tile * stride);
  }
}

}  // namespace

BlasFactor MakeBlasFactor(const ExactGp& exact) {
  const ReducedPosterior posterior = ExactPosterior(exact);
  const Hyperparameters& hyper = exact.hyperparameters();
  BlasFactor f;
  f.n = static_cast<int>(exact.inputs().rows());
  f.dim = static_cast<int>(exact.inputs().cols());
  f.signal_variance = hyper.signal_std * hyper.signal_std;
  f.noise_variance = hyper.noise_std * hyper.noise_std;
  for (int d = 0; d < f.dim; ++d) {
    f.scale.push_back(std::sqrt(0.5 * std::numbers::log2e) / hyper.lengthscales[d]);
    f.centre.push_back(f.scale[d] * exact.inputs().col(d).mean());
  }
  for (int i = 0; i < f.n; ++i) {
    for (int d = 0; d < f.dim; ++d) {
      f.inputs.push_back(f.scale[d] * exact.inputs()(i, d) - f.centre[d]);
    }
    f.weights.push_back(f.signal_variance * posterior.weights[i]);
  }
  for (const double inverse : posterior.root.reshaped()) {
    f.triangle.push_back(f.signal_variance * inverse);
  }
  return f;
}

std::size_t BlasQueryScratchBytes(const BlasFactor& factor, int n_tiles) {
  return sizeof(double) * n_tiles * kTileLanes * (factor.dim + factor.n + 2);
}

void BlasQuery(const BlasFactor& factor, int n_tiles, std::size_t stride, const double* x,
               void* scratch, double* mean, double* variance) {
  const SingleThreadedBlas single_threaded;
  const int n_queries = n_tiles * kTileLanes, n = factor.n, step = 1;
  const double one = 1, zero = 0;
  double* const queries = static_cast<double*>(scratch);
  double* const e = queries + static_cast<std::size_t>(factor.dim) * n_queries;
  double* const means = e + static_cast<std::size_t>(n) * n_queries;
  double* const variances = means + n_queries;
  ScaleQueries(factor, n_tiles, stride, x, queries);
  QueryCovariances(n_queries, n, factor.dim, queries, factor.inputs.data(), e);
  dgemv_("N", &n_queries, &n, &one, e, &n_queries, factor.weights.data(), &step, &zero, means,
         &step);
  CopyToTiles(means, n_tiles, stride, mean);
  if (variance == nullptr) return;
  dtrmm_("R", "L", "T", "N", &n_queries, &n, &one, factor.triangle.data(), &n, e, &n_queries);
  QueryVariances(n_queries, n, factor.signal_variance, e, variances);
  CopyToTiles(variances, n_tiles, stride, variance);
}

}  // namespace downpour
