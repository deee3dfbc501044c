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
//
// W e cancels: its terms are larger than its sum by up to signal_std / noise_std, which float
// cannot afford. A deflation first takes away the large smooth part of e: what e of the first
// kRowBlock points, e_first = V_first z, explains at all others by a lower-trapezoidal V (n x
// kRowBlock). Weights and W are then replaced by w' and W' of e' = (z, e_rest - V_rest z), such
// that w'^T e' = w^T e and W' e' = W e.
template <typename T>
struct GpFactorT {
  int n = 0;         // points
  int dim = 0;       // input dimensions D
  int n_padded = 0;  // n rounded up to a multiple of kRowBlock
  double signal_variance = 0;
  double noise_variance = 0;
  AlignedVector<double> scale;   // (D)  s_d
  AlignedVector<double> centre;  // (D)  c_d
  AlignedVector<T> inputs;       // (n_padded x D) s_d x_id - c_d at PointOffset; padding zero
  AlignedVector<T> weights;      // (n_padded), padding zero
  AlignedVector<T> triangle;     // W, packed as triangle_layout.h says; padding rows are zero
  // V (n_padded x kRowBlock) at PointOffset, reciprocals on its diagonal, padding zero; or empty.
  AlignedVector<T> deflation;
};

using GpFactor = GpFactorT<double>;
using GpFactor32 = GpFactorT<float>;

// What a factor is made of, in double.
struct GpPosterior {
  int n = 0, dim = 0;                    // >= 1
  const double* inputs = nullptr;        // n x D row-major
  const double* lengthscales = nullptr;  // (D)
  double signal_std = 0, noise_std = 0;
  const double* weights = nullptr;         // (n)  K^-1 y
  const double* inverse_factor = nullptr;  // L^-1, n x n COLUMN-major; its lower triangle is read
  // V, n x kRowBlock COLUMN-major, its lower trapezoid read, n >= kRowBlock, no zeros on the
  // diagonal; nullptr: no deflation.
  const double* deflation = nullptr;
};

// Builds a factor: computed in double, rounded once. For float, values beyond its range become
// infinite, and queries NaN or infinite. Instantiated for double and float.
template <typename T>
GpFactorT<T> PackGpFactor(const GpPosterior& posterior);

// Bytes of scratch that GpQueryTile needs for a factor.
std::size_t GpQueryScratchBytes(const GpFactor& factor);
std::size_t GpQueryScratchBytes(const GpFactor32& factor);

// Mean and latent variance of one output for the first n_lanes queries of a tile (paper Eq. 5),
// 1 <= n_lanes <= kTileLanes; work is done for whole vectors, or for up to three lanes alone, and
// lanes beyond the last vector are neither read nor written.
//   x        D x kTileLanes, aligned; scratch aligned, GpQueryScratchBytes
//   mean     kTileLanes, aligned
//   variance kTileLanes, aligned, latent (without noise), clamped to >= 0; nullptr: mean only
// No argument may alias another. Thread-safe, does not allocate. A lane's bits do not depend on
// n_lanes, its place or its neighbours. A lane whose x is not finite gives NaN in that lane only; a
// finite x whose s_d x_d - c_d is beyond float gives NaN or the prior. Error against exact
// arithmetic on the same factor, with eps of T,
// u = (n + D + 4) eps, a_d = s_d x_d - c_d, p_d = s_d x_id - c_d and
// b_i = e_i (1 + sum_d ((a_d - p_d)^2 + |a_d - p_d| (|a_d| + |p_d| + |s_d x_d|))):
//   mean      u sum_i |weights_i| b_i
//   variance  u (signal_variance + 2 sum_r |(W e)_r| sum_j |W_rj| b_j): it cancels, so that the
//             relative error grows as the variance falls
// A deflation adds sum_k |V_ik z_k| to b_i, and to the sums of b its own rounding,
// sum_i |w'_i e'_i| and sum_j |W'_rj e'_j|.
void GpQueryTile(const GpFactor& factor, int n_lanes, const double* x, void* scratch, double* mean,
                 double* variance);
void GpQueryTile(const GpFactor32& factor, int n_lanes, const double* x, void* scratch,
                 double* mean, double* variance);

}  // namespace downpour
