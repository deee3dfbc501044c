// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/compression.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <type_traits>

#include "engine/gp/triangle.h"
#include "engine/lapack.h"
#include "engine/single_threaded_blas.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// n x D inputs in units of the lengthscales.
Eigen::ArrayXXd ScaledInputs(const ExactGp& exact) {
  Eigen::ArrayXXd scaled = exact.inputs();
  for (Eigen::Index d = 0; d < scaled.cols(); ++d) {
    scaled.col(d) /= exact.hyperparameters().lengthscales[d];
  }
  return scaled;
}

// Column p of the noise-free K (paper Eq. 6).
Eigen::VectorXd CovarianceColumn(const Eigen::ArrayXXd& scaled, double signal_variance,
                                 Eigen::Index p) {
  Eigen::ArrayXd distance = Eigen::ArrayXd::Zero(scaled.rows());
  for (Eigen::Index d = 0; d < scaled.cols(); ++d) {
    distance += (scaled.col(d) - scaled(p, d)).square();
  }
  return signal_variance * (-0.5 * distance).exp();
}

// Pivoted Cholesky of K until the largest residual is below `limit`: returns V^T (n x m).
Eigen::MatrixXd PivotedCholesky(const Eigen::ArrayXXd& scaled, double signal_variance, double limit,
                                std::vector<int>* points, std::vector<double>* residuals) {
  const Eigen::Index n = scaled.rows();
  Eigen::MatrixXd v(n, std::min<Eigen::Index>(n, 64));
  Eigen::ArrayXd residual = Eigen::ArrayXd::Constant(n, signal_variance);
  for (Eigen::Index m = 0; m < n; ++m) {
    Eigen::Index p = 0;
    const double largest = residual.maxCoeff(&p);
    if (m > 0 && largest < limit) break;
    if (m == v.cols()) v.conservativeResize(n, std::min(n, 2 * m));
    Eigen::VectorXd column = CovarianceColumn(scaled, signal_variance, p);
    column.noalias() -= v.leftCols(m) * v.row(p).head(m).transpose();
    v.col(m) = column / std::sqrt(largest);
    residual = (residual - v.col(m).array().square()).max(0.0);
    points->push_back(static_cast<int>(p));
    residuals->push_back(largest);
  }
  v.conservativeResize(n, points->size());
  return v;
}

// Lower-triangular T with T^T T = G (leading m x m block; lower triangle read): Cholesky from the
// last row upwards. Where G is singular to rounding, its diagonal grows until it factors.
Eigen::MatrixXd ReversedCholesky(const Eigen::MatrixXd& gram, int m, double rounding) {
  Eigen::MatrixXd reversed(m, m), t = Eigen::MatrixXd::Zero(m, m);
  for (int info = 1; info != 0; rounding *= 10) {
    for (int j = 0; j < m; ++j) {
      for (int i = j; i < m; ++i) reversed(i, j) = gram(m - 1 - j, m - 1 - i);
      reversed(j, j) += rounding;
    }
    dpotrf_("L", &m, reversed.data(), &m, &info);
  }
  for (int j = 0; j < m; ++j) {
    for (int i = j; i < m; ++i) t(i, j) = reversed(m - 1 - j, m - 1 - i);
  }
  return t;
}

}  // namespace

Compression::Compression(const ExactGp& exact, double tau) {
  const SingleThreadedBlas single_threaded;
  const Hyperparameters& hyper = exact.hyperparameters();
  const int n = static_cast<int>(exact.inputs().rows());
  const double signal_variance = hyper.signal_std * hyper.signal_std, one = 1, zero = 0;
  noise_variance_ = hyper.noise_std * hyper.noise_std + exact.jitter();
  const double limit = std::max(tau * noise_variance_, 4 * n * kEps * signal_variance);
  Eigen::MatrixXd v =
      PivotedCholesky(ScaledInputs(exact), signal_variance, limit, &points_, &residuals_);
  const int m = size();
  projected_alpha_ = v.transpose() * exact.alpha();

  // The rows of V^T at the picks are L_m.
  inverse_factor_ = Eigen::MatrixXd::Zero(m, m);
  for (int i = 0; i < m; ++i) {
    inverse_factor_.row(i).head(i + 1) = v.row(points_[i]).head(i + 1);
  }
  if (m >= kRowBlock) deflation_ = inverse_factor_.leftCols(kRowBlock) / hyper.signal_std;
  InvertLowerTriangle(m, inverse_factor_.data(), m);

  Eigen::MatrixXd inverse = exact.cholesky();
  InvertLowerTriangle(n, inverse.data(), n);
  dtrmm_("L", "L", "N", "N", &n, &m, &one, inverse.data(), &n, v.data(), &n);
  gram_ = Eigen::MatrixXd::Zero(m, m);
  dsyrk_("L", "T", &m, &n, &one, v.data(), &n, &zero, gram_.data(), &m);
  rounding_ = 4 * (n + m) * kEps;
}

int Compression::PointsFor(double tau) const {
  const double limit = tau * noise_variance_;
  const auto done = std::find_if(residuals_.begin() + 1, residuals_.end(),
                                 [limit](double residual) { return residual < limit; });
  return static_cast<int>(done - residuals_.begin());
}

ReducedPosterior Compression::First(int m) const {
  const SingleThreadedBlas single_threaded;
  ReducedPosterior posterior;
  posterior.points.assign(points_.begin(), points_.begin() + m);
  posterior.weights =
      inverse_factor_.topLeftCorner(m, m).triangularView<Eigen::Lower>().transpose() *
      projected_alpha_.head(m);
  // R = T L_m^-1.
  posterior.root = ReversedCholesky(gram_, m, rounding_);
  const int ld = size();
  const double one = 1;
  dtrmm_("R", "L", "N", "N", &m, &m, &one, inverse_factor_.data(), &ld, posterior.root.data(), &m);
  if (m >= kRowBlock) posterior.deflation = deflation_.topRows(m);
  return posterior;
}

template <typename T>
GpFactorT<T> PackPosterior(const ExactGp& exact, const ReducedPosterior& posterior) {
  const int m = static_cast<int>(posterior.points.size());
  const int dim = static_cast<int>(exact.inputs().cols());
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows(m, dim);
  for (int i = 0; i < m; ++i) rows.row(i) = exact.inputs().row(posterior.points[i]);
  const Hyperparameters& hyper = exact.hyperparameters();
  const bool deflate = std::is_same_v<T, float> && posterior.deflation.size() > 0;
  return PackGpFactor<T>({.n = m,
                          .dim = dim,
                          .inputs = rows.data(),
                          .lengthscales = hyper.lengthscales.data(),
                          .signal_std = hyper.signal_std,
                          .noise_std = hyper.noise_std,
                          .weights = posterior.weights.data(),
                          .inverse_factor = posterior.root.data(),
                          .deflation = deflate ? posterior.deflation.data() : nullptr});
}

template GpFactorT<double> PackPosterior(const ExactGp&, const ReducedPosterior&);
template GpFactorT<float> PackPosterior(const ExactGp&, const ReducedPosterior&);

ReducedPosterior ExactPosterior(const ExactGp& exact) {
  const SingleThreadedBlas single_threaded;
  const int n = static_cast<int>(exact.inputs().rows());
  ReducedPosterior posterior{std::vector<int>(n), exact.alpha(), exact.cholesky(), {}};
  std::iota(posterior.points.begin(), posterior.points.end(), 0);
  InvertLowerTriangle(n, posterior.root.data(), n);
  return posterior;
}

}  // namespace downpour
