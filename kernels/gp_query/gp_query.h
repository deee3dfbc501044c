// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include "kernels/aligned.h"

namespace downpour {

// Posterior of one GP output, laid out for GpQueryTile. With s_d = 1/(sqrt(2) l_d) the covariance
// is k(x, x_i) = signal_variance * e_i, e_i = exp(-sum_d (s_d x_d - s_d x_id)^2), and (paper Eq. 5)
//   mean     = sum_i weights_i e_i              weights = signal_variance * K^-1 y
//   variance = signal_variance - |W e|^2        W = signal_variance * L^-1, K = L L^T
struct GpFactor {
  int n = 0;         // points
  int dim = 0;       // input dimensions D
  int n_padded = 0;  // n rounded up to a multiple of kRowBlock
  double signal_variance = 0;
  double noise_variance = 0;
  AlignedVector<double> scale;    // (D)  s_d
  AlignedVector<double> inputs;   // (n_padded x D) row-major s_d x_id; padding rows are zero
  AlignedVector<double> weights;  // (n_padded), padding zero
  // W in blocks of kRowBlock rows: block b holds columns 0 ... kRowBlock (b+1) - 1, column by
  // column, kRowBlock values each; entries above the diagonal and padding are zero.
  AlignedVector<double> triangle;

  static constexpr int kRowBlock = 8;
};

// Builds a factor. `inputs` is n x D row-major (unscaled), `weights` (n) is K^-1 y,
// `inverse_factor` is L^-1, n x n COLUMN-major (only its lower triangle is read).
GpFactor PackGpFactor(int n, int dim, const double* inputs, const double* lengthscales,
                      double signal_std, double noise_std, const double* weights,
                      const double* inverse_factor);

// Doubles of scratch that GpQueryTile needs for a factor.
std::size_t GpQueryScratchSize(const GpFactor& factor);

// Mean and latent variance of one output for kTileLanes queries (paper Eq. 5).
//   x        D x kTileLanes, aligned; scratch aligned, GpQueryScratchSize doubles
//   mean     kTileLanes, aligned
//   variance kTileLanes, aligned, latent (without noise), clamped to >= 0; nullptr: mean only
// No argument may alias another. Thread-safe, does not allocate. A lane whose x is not finite gives
// NaN in that lane only. Error against exact arithmetic on the same factor, with u = (n + D + 4)
// eps and e'_i = e_i (1 + sum_d (D_d^2 + |D_d| (|s_d x_d| + |s_d x_id|))), D_d = s_d x_d - s_d
// x_id:
//   mean      u sum_i |weights_i| e'_i
//   variance  u (signal_variance + 2 sum_r |(W e)_r| sum_j |W_rj| e'_j): it cancels, so that the
//             relative error grows as the variance falls
void GpQueryTile(const GpFactor& factor, const double* x, double* scratch, double* mean,
                 double* variance);

}  // namespace downpour
