// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "kernels/gp_query/gp_query.h"
#include "tests/kernels/each_target.h"

namespace downpour {

// A factor with arbitrary lower-triangular W of a size that makes |W e|^2 of order one, and, if
// asked for (n >= kRowBlock), with an arbitrary deflation.
template <typename T>
GpFactorT<T> RandomFactor(int n, int dim, TestNumbers& random, bool deflate = false) {
  std::vector<double> inputs(n * dim), lengthscales(dim), weights(n), inverse(n * n);
  for (double& x : inputs) x = 2 * random();
  for (double& l : lengthscales) l = (1.5 + random()) * std::sqrt(dim / 4.0 + 1);
  for (double& w : weights) w = random();
  for (double& w : inverse) w = random() / n;
  std::vector<double> deflation(n * kRowBlock);
  for (std::size_t i = 0; i < deflation.size(); ++i) {
    deflation[i] = i % (n + 1) == 0 ? 1 + 0.5 * random() : 0.3 * random();
  }
  return PackGpFactor<T>({.n = n,
                          .dim = dim,
                          .inputs = inputs.data(),
                          .lengthscales = lengthscales.data(),
                          .signal_std = 1.3,
                          .noise_std = 0.1,
                          .weights = weights.data(),
                          .inverse_factor = inverse.data(),
                          .deflation = deflate ? deflation.data() : nullptr});
}

inline AlignedVector<double> RandomQueries(int dim, TestNumbers& random) {
  AlignedVector<double> x(dim * kTileLanes);
  for (double& v : x) v = 2 * random();
  return x;
}

// Query `lane` of a tile.
inline std::vector<double> Lane(const AlignedVector<double>& x, int lane) {
  std::vector<double> query(x.size() / kTileLanes);
  for (std::size_t k = 0; k < query.size(); ++k) query[k] = x[k * kTileLanes + lane];
  return query;
}

struct TileResult {
  AlignedVector<double> mean = AlignedVector<double>(kTileLanes, -7);
  AlignedVector<double> variance = AlignedVector<double>(kTileLanes, -7);
};

template <typename T>
TileResult Query(const GpFactorT<T>& factor, const AlignedVector<double>& x,
                 int n_lanes = kTileLanes) {
  TileResult out;
  AlignedVector<unsigned char> scratch(GpQueryScratchBytes(factor), 0xFF);  // NaN
  GpQueryTile(factor, n_lanes, x.data(), scratch.data(), out.mean.data(), out.variance.data());
  return out;
}

}  // namespace downpour
