// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <vector>

#include "engine/gp/gp_model.h"
#include "kernels/gp_query/gp_query.h"

namespace downpour {

// Posterior of one output carried by m of the training points, k_m = (k(x, x_p))_p:
//   mean = k_m^T weights,   variance = signal_variance - |R k_m|^2
struct ReducedPosterior {
  std::vector<int> points;  // (m) rows of the training inputs
  Eigen::VectorXd weights;  // (m)
  Eigen::MatrixXd root;     // R (m x m), lower triangular, zeros above
  // For queries in float (gp_query.h), or 0 x 0: V (m x kRowBlock), the first columns of L_m /
  // signal_std.
  Eigen::MatrixXd deflation;
};

// Error-controlled compression of an exact GP. Pivoted Cholesky of the noise-free K picks points,
// each the one whose prior variance given the earlier ones (the residual) is largest, until all
// residuals are below tau * s, s = sigma_n^2 + jitter. The first m picks are a compression for
// every m: the exact posterior is kept at the m points and carried elsewhere by the noise-free
// prior (the projection of least KL(exact || reduced); Csato & Opper 2002). With L_m = chol(K_mm),
// V = L_m^-1 K_mn, W = L^-1 V^T, G = W^T W = V K^-1 V^T, a = L_m^-1 k_m:
//   mean     = a^T V alpha                                  weights = L_m^-T V alpha
//   variance = signal_variance - |a|^2 + a^T (I - G) a      R^T R = L_m^-T G L_m^-1
// I - G is the whitened covariance at the points, B^-1 where V V^T stands for all of K. Forming G
// as a Gram matrix rather than I - B^-1 leaves nothing to cancel: its eigenvalues reach down to
// about tau / m only. Error against the exact posterior at any x, with the residual
// r = signal_variance - |a|^2 at x and the residual covariance E = K_nn - V^T V of the training
// inputs (diagonal <= tau s):
//   mean      sqrt(r alpha^T E alpha)
//   variance  r + 2 sqrt(r variance)
// Both fall to 0 with r; where r is large (far from the data) they are loose, so that a plan
// measures the error instead. Rounding adds about 4 (n + m) eps signal_variance to the variance.
// Immutable after construction: const calls are thread-safe. All calls allocate.
class Compression {
 public:
  // O(n^2 m). tau > 0. Residuals below 4 n eps signal_variance, rounding, end the picking too
  // (duplicates are never picked); at least one point is picked.
  Compression(const ExactGp& exact, double tau);

  // Points picked.
  int size() const { return static_cast<int>(points_.size()); }
  // Fewest picks that leave every residual below tau * s; size() if none does. At least 1.
  int PointsFor(double tau) const;
  // Posterior of the first m picks, 1 <= m <= size(). O(m^3). Has a deflation from kRowBlock on.
  ReducedPosterior First(int m) const;

 private:
  double noise_variance_;            // s
  std::vector<int> points_;          // in the order picked
  std::vector<double> residuals_;    // largest residual before each pick
  Eigen::MatrixXd inverse_factor_;   // L_m^-1 of all picks; its leading blocks serve fewer
  Eigen::MatrixXd deflation_;        // of all picks
  Eigen::MatrixXd gram_;             // G, lower triangle
  Eigen::VectorXd projected_alpha_;  // V alpha
  double rounding_;                  // of G's entries
};

// Layout for GpQueryTile; T is double or float, which deflates if it can. `exact` is the model that
// `posterior` reduces.
template <typename T>
GpFactorT<T> PackPosterior(const ExactGp& exact, const ReducedPosterior& posterior);

// The exact posterior as one of all points: weights alpha, R = L^-1.
ReducedPosterior ExactPosterior(const ExactGp& exact);

}  // namespace downpour
