// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include "kernels/aligned.h"
#include "kernels/gp_query/triangle_layout.h"

namespace downpour {

// Posterior of one GP output, laid out for GpQueryTile; T is double or float. With
// s_d = sqrt(log2(e)/2)/l_d and a centre c (mean of the scaled points, so that differences keep
// their digits in T) the covariance is k(x, x_i) = signal_variance * e_i,
// e_i = 2^-sum_d ((s_d x_d - c_d) - (s_d x_id - c_d))^2, and (paper Eq. 5)
//   mean     = sum_i weights_i e_i              weights = signal_variance * K^-1 y
//   variance = signal_variance - |W e|^2        W = signal_variance * L^-1, K = L L^T
// Any lower-triangular W and any weights do: compressed posteriors have the same form.
template <typename T>
struct GpFactorT {
  int n = 0;         // points
  int dim = 0;       // input dimensions D
  int n_padded = 0;  // n rounded up to a multiple of kRowBlock
  double signal_variance = 0;
  double noise_variance = 0;
  AlignedVector<double> scale;   // (D)  s_d
  AlignedVector<double> centre;  // (D)  c_d
  AlignedVector<T> inputs;       // (n_padded x D) row-major s_d x_id - c_d; padding rows are zero
  AlignedVector<T> weights;      // (n_padded), padding zero
  AlignedVector<T> triangle;     // W, packed as triangle_layout.h says; padding rows are zero
};

using GpFactor = GpFactorT<double>;
using GpFactor32 = GpFactorT<float>;

// Builds a factor; computed in double and rounded once. `inputs` is n x D row-major (unscaled),
// `weights` (n) is K^-1 y, `inverse_factor` is L^-1, n x n COLUMN-major (only its lower triangle is
// read). n >= 1, D >= 1. For float, values beyond its range become infinite, and queries NaN or
// infinite. Instantiated for double and float.
template <typename T>
GpFactorT<T> PackGpFactorT(int n, int dim, const double* inputs, const double* lengthscales,
                           double signal_std, double noise_std, const double* weights,
                           const double* inverse_factor);

inline GpFactor PackGpFactor(int n, int dim, const double* inputs, const double* lengthscales,
                             double signal_std, double noise_std, const double* weights,
                             const double* inverse_factor) {
  return PackGpFactorT<double>(n, dim, inputs, lengthscales, signal_std, noise_std, weights,
                               inverse_factor);
}

// Bytes of scratch that GpQueryTile needs for a factor.
std::size_t GpQueryScratchBytes(const GpFactor& factor);
std::size_t GpQueryScratchBytes(const GpFactor32& factor);

// Mean and latent variance of one output for the first n_lanes queries of a tile (paper Eq. 5),
// 1 <= n_lanes <= kTileLanes; work is done for whole vectors only, and lanes beyond the last vector
// are neither read nor written.
//   x        D x kTileLanes, aligned; scratch aligned, GpQueryScratchBytes
//   mean     kTileLanes, aligned
//   variance kTileLanes, aligned, latent (without noise), clamped to >= 0; nullptr: mean only
// No argument may alias another. Thread-safe, does not allocate. A lane's bits do not depend on
// n_lanes, its place or its neighbours. A lane whose x is not finite gives NaN in that lane only; a
// finite x whose s_d x_d - c_d is beyond float gives NaN or the prior. Error against exact
// arithmetic on the same factor, with eps of T,
// u = (n + D + 4) eps, a_d = s_d x_d - c_d, b_d = s_d x_id - c_d and
// e'_i = e_i (1 + sum_d ((a_d - b_d)^2 + |a_d - b_d| (|a_d| + |b_d| + |s_d x_d|))):
//   mean      u sum_i |weights_i| e'_i
//   variance  u (signal_variance + 2 sum_r |(W e)_r| sum_j |W_rj| e'_j): it cancels, so that the
//             relative error grows as the variance falls
void GpQueryTile(const GpFactor& factor, int n_lanes, const double* x, void* scratch, double* mean,
                 double* variance);
void GpQueryTile(const GpFactor32& factor, int n_lanes, const double* x, void* scratch,
                 double* mean, double* variance);

}  // namespace downpour
