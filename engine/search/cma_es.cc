// SPDX-License-Identifier: Apache-2.0
#include "engine/search/cma_es.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "engine/lapack.h"
#include "engine/single_threaded_blas.h"

// Equation numbers are those of the tutorial (arXiv 1604.00772), appendix A and C.
namespace downpour {

int CmaEs::DefaultPopulation(int dimension) {
  return 4 + static_cast<int>(std::floor(3 * std::log(dimension)));  // Eq. 48
}

CmaEs::CmaEs(std::span<const double> mean, double sigma, int population,
             const CmaEsTolerances& tolerances)
    : dimension_(static_cast<int>(mean.size())),
      population_(population),
      tolerances_(tolerances),
      initial_sigma_(sigma),
      sigma_(sigma),
      mean_(Eigen::Map<const Eigen::VectorXd>(mean.data(), dimension_)),
      path_sigma_(Eigen::VectorXd::Zero(dimension_)),
      path_c_(Eigen::VectorXd::Zero(dimension_)),
      covariance_(Eigen::MatrixXd::Identity(dimension_, dimension_)),
      axes_(covariance_),
      lengths_(Eigen::VectorXd::Ones(dimension_)),
      root_(covariance_),
      history_(dimension_, population_),
      z_(dimension_, population_),
      y_(dimension_, population_),
      selected_(dimension_, population_ + 1),
      scaled_axes_(dimension_, dimension_),
      step_(dimension_),
      step_z_(dimension_),
      costs_(population_),
      ranking_(population_) {
  SetStrategyParameters();
  const char jobz = 'V', uplo = 'L';
  const int query = -1;
  double work_size = 0;
  int integer_work_size = 0, info = 0;
  dsyevd_(&jobz, &uplo, &dimension_, axes_.data(), &dimension_, lengths_.data(), &work_size, &query,
          &integer_work_size, &query, &info);
  work_.resize(static_cast<std::size_t>(work_size));
  integer_work_.resize(static_cast<std::size_t>(integer_work_size));
}

void CmaEs::SetStrategyParameters() {
  const double n = dimension_;
  parents_ = population_ / 2;
  const int others = population_ - parents_;
  weights_.resize(population_);
  for (int i = 0; i < population_; ++i) {
    weights_[i] = std::log((population_ + 1) / 2.0) - std::log(i + 1.0);  // Eq. 49
  }
  const auto good = weights_.head(parents_);
  const auto bad = weights_.tail(others);
  mu_eff_ = good.sum() * good.sum() / good.squaredNorm();
  const double mu_eff_minus = bad.sum() * bad.sum() / bad.squaredNorm();
  c_sigma_ = (mu_eff_ + 2) / (n + mu_eff_ + 5);  // Eq. 55
  d_sigma_ = 1 + 2 * std::max(0.0, std::sqrt((mu_eff_ - 1) / (n + 1)) - 1) + c_sigma_;
  c_c_ = (4 + mu_eff_ / n) / (n + 4 + 2 * mu_eff_ / n);         // Eq. 56
  c_1_ = 2 / ((n + 1.3) * (n + 1.3) + mu_eff_);                 // Eq. 57
  c_mu_ = std::min(1 - c_1_, 2 * (mu_eff_ - 2 + 1 / mu_eff_) /  // Eq. 58
                                 ((n + 2) * (n + 2) + mu_eff_));
  const double alpha = std::min({1 + c_1_ / c_mu_,                      // Eq. 50
                                 1 + 2 * mu_eff_minus / (mu_eff_ + 2),  // Eq. 51
                                 (1 - c_1_ - c_mu_) / (n * c_mu_)});    // Eq. 52
  const double good_sum = good.sum(), bad_sum = bad.cwiseAbs().sum();
  weights_.head(parents_) /= good_sum;  // Eq. 53
  weights_.tail(others) *= alpha / bad_sum;
  expected_norm_ = std::sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n));
  // C changes little within 1 / (c_1 + c_mu) generations. The tutorial waits a tenth of that over
  // P; twenty times longer needs no more evaluations (10-D and 20-D ellipsoid and Rosenbrock) and,
  // at P = 71 and lambda = 32, takes 49 us a generation in Tell instead of 390.
  eigen_interval_ = std::max(1, static_cast<int>(2 / (n * (c_1_ + c_mu_))));
}

void CmaEs::Ask(StreamKey key, std::span<double> candidates) {
  for (int c = 0; c < population_; ++c) {
    FillNormals(key, static_cast<std::uint32_t>(c), z_.col(c).data(),
                static_cast<std::size_t>(dimension_));  // Eq. 38
  }
  // Eq. 39 with the symmetric root, so that C^(-1/2) y = z needs no product.
  const SingleThreadedBlas single_threaded;
  const char side = 'L', uplo = 'L';
  const double one = 1, zero = 0;
  dsymm_(&side, &uplo, &dimension_, &population_, &one, root_.data(), &dimension_, z_.data(),
         &dimension_, &zero, y_.data(), &dimension_);
  Eigen::Map<Eigen::MatrixXd> x(candidates.data(), dimension_, population_);
  x = (sigma_ * y_).colwise() + mean_;  // Eq. 40
}

void CmaEs::Tell(std::span<const double> costs) {
  std::iota(ranking_.begin(), ranking_.end(), 0);
  const auto cost = [&](int c) {
    return std::isnan(costs[c]) ? std::numeric_limits<double>::infinity() : costs[c];
  };
  std::sort(ranking_.begin(), ranking_.end(), [&](int a, int b) {
    const double cost_a = cost(a), cost_b = cost(b);
    return cost_a != cost_b ? cost_a < cost_b : a < b;
  });
  Tell(costs, ranking_);
}

void CmaEs::Tell(std::span<const double> costs, std::span<const int> ranking) {
  ++generation_;
  step_.setZero();
  step_z_.setZero();
  for (int i = 0; i < parents_; ++i) {
    step_ += weights_[i] * y_.col(ranking[i]);  // Eq. 41
    step_z_ += weights_[i] * z_.col(ranking[i]);
  }
  mean_ += sigma_ * step_;  // Eq. 42
  path_sigma_ = (1 - c_sigma_) * path_sigma_ +
                std::sqrt(c_sigma_ * (2 - c_sigma_) * mu_eff_) * step_z_;  // Eq. 43
  const double norm = path_sigma_.norm();
  // The tutorial's g + 1 is generation_, which counts this generation already.
  const double settled = std::sqrt(1 - std::pow(1 - c_sigma_, 2.0 * generation_));
  const bool h_sigma = norm / settled < (1.4 + 2.0 / (dimension_ + 1)) * expected_norm_;
  path_c_ *= 1 - c_c_;
  if (h_sigma) path_c_ += std::sqrt(c_c_ * (2 - c_c_) * mu_eff_) * step_;  // Eq. 45
  UpdateCovariance(ranking, h_sigma);
  sigma_ *= std::exp(c_sigma_ / d_sigma_ * (norm / expected_norm_ - 1));  // Eq. 44
  if (generation_ - eigen_generation_ >= eigen_interval_) UpdateEigensystem();

  std::transform(costs.begin(), costs.end(), costs_.begin(), [](double cost) {
    return std::isnan(cost) ? std::numeric_limits<double>::infinity() : cost;
  });
  history_.Append(costs_);
  stop_ = FindStop();
}

void CmaEs::UpdateCovariance(std::span<const int> ranking, bool h_sigma) {
  // Eq. 46 and 47, the positive and the negative terms each as one symmetric product. Column 0 is
  // the rank-one term.
  selected_.col(0) = std::sqrt(c_1_) * path_c_;
  for (int i = 0; i < population_; ++i) {
    const int c = ranking[i];
    double weight = c_mu_ * std::abs(weights_[i]);
    // ||C^(-1/2) y||^2 = ||z||^2.
    if (i >= parents_) weight *= dimension_ / z_.col(c).squaredNorm();
    selected_.col(i + 1) = std::sqrt(weight) * y_.col(c);
  }
  const double delta = h_sigma ? 0 : c_c_ * (2 - c_c_);
  const double decay = 1 + c_1_ * delta - c_1_ - c_mu_ * weights_.sum();
  const SingleThreadedBlas single_threaded;
  const char uplo = 'L', trans = 'N';
  const double one = 1, minus_one = -1;
  const int positive = parents_ + 1, negative = population_ - parents_;
  dsyrk_(&uplo, &trans, &dimension_, &positive, &one, selected_.data(), &dimension_, &decay,
         covariance_.data(), &dimension_);
  dsyrk_(&uplo, &trans, &dimension_, &negative, &minus_one, selected_.col(positive).data(),
         &dimension_, &one, covariance_.data(), &dimension_);
}

void CmaEs::UpdateEigensystem() {
  eigen_generation_ = generation_;
  axes_ = covariance_;
  const SingleThreadedBlas single_threaded;
  const char jobz = 'V', uplo = 'L', trans = 'N';
  const int work_size = static_cast<int>(work_.size());
  const int integer_work_size = static_cast<int>(integer_work_.size());
  int info = 0;
  dsyevd_(&jobz, &uplo, &dimension_, axes_.data(), &dimension_, lengths_.data(), work_.data(),
          &work_size, integer_work_.data(), &integer_work_size, &info);
  const double smallest = lengths_[0], largest = lengths_[dimension_ - 1];
  // A matrix that is no longer positive definite ends the run as ConditionCov.
  condition_ =
      info == 0 && smallest > 0 ? largest / smallest : std::numeric_limits<double>::infinity();
  lengths_ = lengths_.cwiseMax(0.0).cwiseSqrt();
  // C^(1/2) = (B D^(1/2)) (B D^(1/2))^T.
  scaled_axes_.noalias() = axes_ * lengths_.cwiseSqrt().asDiagonal();
  const double one = 1, zero = 0;
  dsyrk_(&uplo, &trans, &dimension_, &dimension_, &one, scaled_axes_.data(), &dimension_, &zero,
         root_.data(), &dimension_);
}

std::string_view CmaEs::FindStop() {
  if (history_.HasEqualBest()) return "EqualFunValues";
  if (history_.IsFlat(tolerances_.hist_fun)) return "TolHistFun";
  if (IsBelowTolX()) return "TolX";
  if (sigma_ * lengths_.maxCoeff() > tolerances_.x_up * initial_sigma_) return "TolXUp";
  if (!(condition_ <= tolerances_.condition_cov)) return "ConditionCov";
  if (HasNoEffectAxis()) return "NoEffectAxis";
  if (HasNoEffectCoord()) return "NoEffectCoord";
  if (history_.IsStagnant()) return "Stagnation";
  return {};
}

bool CmaEs::IsBelowTolX() const {
  const double tolerance = tolerances_.x * initial_sigma_;
  for (int i = 0; i < dimension_; ++i) {
    if (sigma_ * std::sqrt(covariance_(i, i)) >= tolerance) return false;
    if (sigma_ * std::abs(path_c_[i]) >= tolerance) return false;
  }
  return true;
}

// A tenth of a standard deviation along the principal axis of this generation changes nothing.
bool CmaEs::HasNoEffectAxis() const {
  const int axis = generation_ % dimension_;
  for (int i = 0; i < dimension_; ++i) {
    if (mean_[i] != mean_[i] + 0.1 * sigma_ * lengths_[axis] * axes_(i, axis)) return false;
  }
  return true;
}

// A fifth of a standard deviation in some coordinate changes nothing.
bool CmaEs::HasNoEffectCoord() const {
  for (int i = 0; i < dimension_; ++i) {
    if (mean_[i] == mean_[i] + 0.2 * sigma_ * std::sqrt(covariance_(i, i))) return true;
  }
  return false;
}

}  // namespace downpour
