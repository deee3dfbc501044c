// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/gp_model.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>

#include "engine/errors.h"
#include "engine/gp/checks.h"
#include "engine/gp/dataset.h"
#include "engine/gp/triangle.h"
#include "engine/lapack.h"
#include "engine/single_threaded_blas.h"
#include "kernels/se_ard/se_ard.h"

namespace downpour {
namespace {

double Square(double x) { return x * x; }

// Lower triangle of the noise-free K (paper Eq. 6), zeros above.
Eigen::MatrixXd Covariance(const Eigen::MatrixXd& inputs, const Hyperparameters& hyperparameters) {
  const int n = static_cast<int>(inputs.rows()), dim = static_cast<int>(inputs.cols());
  Eigen::MatrixXd scaled(n, dim);
  for (int d = 0; d < dim; ++d) scaled.col(d) = inputs.col(d) / hyperparameters.lengthscales[d];
  if (!scaled.allFinite()) {
    throw InvalidInput("GP inputs: an input divided by its lengthscale is not finite");
  }
  Eigen::MatrixXd k = Eigen::MatrixXd::Zero(n, n);
  SeArdCovarianceLower(n, dim, scaled.data(), n, Square(hyperparameters.signal_std), k.data(), n);
  return k;
}

// Overwrites the lower triangle of K + (noise + jitter) I by L; returns the jitter it took.
double FactoriseWithJitter(const Eigen::MatrixXd& covariance, double signal_variance,
                           double noise_variance, Eigen::MatrixXd* factor) {
  const int n = static_cast<int>(covariance.rows());
  double jitter = 0;
  while (jitter <= signal_variance) {
    *factor = covariance;
    factor->diagonal().array() += noise_variance + jitter;
    int info = 0;
    dpotrf_("L", &n, factor->data(), &n, &info);
    if (info == 0) return jitter;
    jitter = jitter == 0 ? 1e-10 * signal_variance : 10 * jitter;
  }
  throw InvalidInput("GP covariance: no Cholesky factor with jitter up to signal_std^2");
}

}  // namespace

ExactGp::ExactGp(const Eigen::MatrixXd& inputs, const Eigen::VectorXd& targets,
                 const Hyperparameters& hyperparameters)
    : hyperparameters_(hyperparameters), inputs_(inputs), targets_(targets) {
  CheckTrainingData(inputs, targets);
  CheckHyperparameters(hyperparameters, inputs.cols());
  const SingleThreadedBlas single_threaded;
  jitter_ =
      FactoriseWithJitter(Covariance(inputs, hyperparameters), Square(hyperparameters.signal_std),
                          Square(hyperparameters.noise_std), &cholesky_);
  SolveAlpha();
}

ExactGp::ExactGp(const Dataset& data, const Hyperparameters& hyperparameters)
    : ExactGp(data.inputs, data.targets.col(0), hyperparameters) {}

ExactGp::ExactGp(std::span<const double> inputs, int n_inputs, std::span<const double> targets,
                 const Hyperparameters& hyperparameters)
    : ExactGp(MakeDataset(inputs, n_inputs, targets, 1), hyperparameters) {}

void ExactGp::SolveAlpha() {
  alpha_ = targets_;
  const int n = static_cast<int>(targets_.size()), one = 1;
  int info = 0;
  dpotrs_("L", &n, &one, cholesky_.data(), &n, alpha_.data(), &n, &info);
  log_marginal_likelihood_ = -0.5 * targets_.dot(alpha_) -
                             cholesky_.diagonal().array().log().sum() -
                             0.5 * n * std::log(2 * std::numbers::pi);
}

//  [ K   C^T ]   [ L         0       ] [ L         0       ]^T
//  [ C   D   ] = [ C L^-T    chol(S) ] [ C L^-T    chol(S) ]   ,  S = D - C L^-T (C L^-T)^T
ExactGp ExactGp::Append(const Eigen::MatrixXd& inputs, const Eigen::VectorXd& targets) const {
  CheckTrainingData(inputs, targets);
  if (inputs.cols() != inputs_.cols()) {
    throw InvalidInput("GP append: points have " + std::to_string(inputs.cols()) +
                       " inputs, must have " + std::to_string(inputs_.cols()));
  }
  const int n = static_cast<int>(inputs_.rows()), k = static_cast<int>(inputs.rows()), m = n + k;
  Eigen::MatrixXd all_inputs(m, inputs.cols());
  all_inputs << inputs_, inputs;
  Eigen::VectorXd all_targets(m);
  all_targets << targets_, targets;
  if (jitter_ > 0) return ExactGp(all_inputs, all_targets, hyperparameters_);

  const SingleThreadedBlas single_threaded;
  Eigen::MatrixXd l = Covariance(all_inputs, hyperparameters_);
  l.topLeftCorner(n, n) = cholesky_;
  l.diagonal().tail(k).array() += Square(hyperparameters_.noise_std);
  double* const c = l.data() + n;
  double* const s = c + static_cast<std::size_t>(n) * m;
  const double one = 1, minus_one = -1;
  int info = 0;
  dtrsm_("R", "L", "T", "N", &k, &n, &one, l.data(), &m, c, &m);
  dsyrk_("L", "N", &k, &n, &minus_one, c, &m, &one, s, &m);
  dpotrf_("L", &k, s, &m, &info);
  if (info != 0) return ExactGp(all_inputs, all_targets, hyperparameters_);
  ExactGp extended;
  extended.hyperparameters_ = hyperparameters_;
  extended.inputs_ = std::move(all_inputs);
  extended.targets_ = std::move(all_targets);
  extended.cholesky_ = std::move(l);
  extended.SolveAlpha();
  return extended;
}

ExactGp ExactGp::Append(std::span<const double> inputs, int n_inputs,
                        std::span<const double> targets) const {
  const Dataset data = MakeDataset(inputs, n_inputs, targets, 1);
  return Append(data.inputs, data.targets.col(0));
}

void ExactGp::Predict(std::span<const double> input, bool with_noise, double* mean,
                      double* variance) const {
  const auto size = static_cast<Eigen::Index>(input.size());
  Predict(Eigen::Map<const Eigen::VectorXd>(input.data(), size), mean, variance);
  if (with_noise) *variance += Square(hyperparameters_.noise_std);
}

// Paper Eq. 5: mean = k^T alpha, variance = sigma_f^2 - |L^-1 k|^2.
void ExactGp::Predict(const Eigen::VectorXd& input, double* mean, double* variance) const {
  if (input.size() != inputs_.cols()) {
    throw InvalidInput("GP query: " + std::to_string(input.size()) + " inputs, must be " +
                       std::to_string(inputs_.cols()));
  }
  const Eigen::Map<const Eigen::ArrayXd> lengthscales(hyperparameters_.lengthscales.data(),
                                                      inputs_.cols());
  const double signal_variance = Square(hyperparameters_.signal_std);
  Eigen::VectorXd k(inputs_.rows());
  for (Eigen::Index i = 0; i < inputs_.rows(); ++i) {
    const double distance =
        ((inputs_.row(i).transpose() - input).array() / lengthscales).square().sum();
    k[i] = signal_variance * std::exp(-0.5 * distance);
  }
  *mean = k.dot(alpha_);
  cholesky_.triangularView<Eigen::Lower>().solveInPlace(k);
  *variance = std::max(0.0, signal_variance - k.squaredNorm());
}

GpFactor ExactGp::Pack() const {
  const SingleThreadedBlas single_threaded;
  const int n = static_cast<int>(inputs_.rows()), dim = static_cast<int>(inputs_.cols());
  Eigen::MatrixXd inverse = cholesky_;
  InvertLowerTriangle(n, inverse.data(), n);
  const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows = inputs_;
  return PackGpFactor<double>({.n = n,
                               .dim = dim,
                               .inputs = rows.data(),
                               .lengthscales = hyperparameters_.lengthscales.data(),
                               .signal_std = hyperparameters_.signal_std,
                               .noise_std = hyperparameters_.noise_std,
                               .weights = alpha_.data(),
                               .inverse_factor = inverse.data()});
}

}  // namespace downpour
