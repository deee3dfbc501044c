// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include "engine/gp/gp_model.h"
#include "kernels/aligned.h"

namespace downpour {

// An exact fp64 posterior for queries by OpenBLAS: the reference and the fallback of the fused
// kernel (kernels/gp_query/gp_query.h), with which they share the exponential, but neither loops
// nor layout. With s_d = sqrt(log2(e)/2)/l_d, the centre c (mean of the scaled points) and
// e_i = 2^-sum_d ((s_d x_d - c_d) - (s_d x_id - c_d))^2 (paper Eq. 5 and 6)
//   mean     = sum_i weights_i e_i              weights = signal_variance * K^-1 y
//   variance = signal_variance - |W e|^2        W = signal_variance * L^-1, K = L L^T
struct BlasFactor {
  int n = 0;    // points
  int dim = 0;  // input dimensions D
  double signal_variance = 0;
  double noise_variance = 0;
  AlignedVector<double> scale;     // (D)  s_d
  AlignedVector<double> centre;    // (D)  c_d
  AlignedVector<double> inputs;    // (n x D) row-major s_d x_id - c_d
  AlignedVector<double> weights;   // (n)
  AlignedVector<double> triangle;  // (n x n) column-major W, zeros above
};

// The posterior of `exact`. Allocates.
BlasFactor MakeBlasFactor(const ExactGp& exact);

// Most tiles that a rollout queries at once (engine/rollout/evaluator.h).
inline constexpr int kBlasTiles = 5;

// Bytes of scratch that queries of n_tiles tiles need.
std::size_t BlasQueryScratchBytes(const BlasFactor& factor, int n_tiles);

// Mean and latent variance of one output for whole tiles (paper Eq. 5), n_tiles >= 1:
//   e = covariances (SIMD), mean = e weights (dgemv), V = e W^T (dtrmm), variance = signal_variance
//   - |rows of V|^2 (SIMD)
// Tile t begins `stride` elements after tile t - 1 in x, mean and variance.
//   x        D x kTileLanes a tile, aligned; scratch aligned, BlasQueryScratchBytes
//   mean     kTileLanes a tile, aligned
//   variance kTileLanes a tile, aligned, latent, clamped to >= 0; nullptr: mean only
// No argument may alias another. A lane whose x is not finite gives NaN in that lane only. The same
// call gives the same bits, but OpenBLAS promises no more: a lane's bits may depend on n_tiles and
// on its place. Thread-safe; calls OpenBLAS on the calling thread alone; allocates nothing but
// OpenBLAS's own buffer, once a thread. Error against exact arithmetic on the same factor, with
// u = (n + D + 4) eps, a_d = s_d x_d - c_d, b_d = s_d x_id - c_d and
// e'_i = e_i (1 + sum_d ((a_d - b_d)^2 + |a_d - b_d| (|a_d| + |b_d| + |s_d x_d|))):
//   mean      u sum_i |weights_i| e'_i
//   variance  u (signal_variance + 2 sum_r |(W e)_r| sum_j |W_rj| e'_j)
void BlasQuery(const BlasFactor& factor, int n_tiles, std::size_t stride, const double* x,
               void* scratch, double* mean, double* variance);

// A single tile, called as the fused kernel is; all lanes are computed.
inline std::size_t GpQueryScratchBytes(const BlasFactor& factor) {
  return BlasQueryScratchBytes(factor, 1);
}
inline void GpQueryTile(const BlasFactor& factor, int /*n_lanes*/, const double* x, void* scratch,
                        double* mean, double* variance) {
  BlasQuery(factor, 1, 0, x, scratch, mean, variance);
}

}  // namespace downpour
