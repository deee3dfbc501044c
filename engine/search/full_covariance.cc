// SPDX-License-Identifier: Apache-2.0
#include "engine/search/full_covariance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "engine/lapack.h"
#include "engine/single_threaded_blas.h"
#include "kernels/covariance/covariance.h"

// Equation numbers are those of the tutorial (arXiv 1604.00772).
namespace downpour {
namespace {

// `share` of the generations within which C changes, 1 / (c_1 + c_mu).
int Interval(const StrategyParameters& parameters, double share) {
  return std::max(1, static_cast<int>(share / (parameters.c_1 + parameters.c_mu)));
}

}  // namespace

FullCovariance::FullCovariance(const StrategyParameters& parameters, int dimension, int population)
    : dimension_(dimension),
      population_(population),
      // The tutorial waits a tenth of this, which needs as many evaluations (71-D cigar, ellipsoid
      // and Rosenbrock at lambda = 16: 2, 0 and 1 % less; twice as long needs 2 % more).
      factor_interval_(Interval(parameters, 1.0 / dimension)),
      // At P = 71 eigenvectors take 30 times as long as the factor.
      axes_interval_(Interval(parameters, 0.5)),
      covariance_(Eigen::MatrixXd::Identity(dimension, dimension)),
      factor_(covariance_),
      axes_(covariance_),
      lengths_(Eigen::VectorXd::Ones(dimension)),
      waiting_weights_(Eigen::VectorXd::Zero(kMostWaiting * (population + 1))),
      waiting_(Eigen::MatrixXd::Zero(dimension, kMostWaiting * (population + 1))),
      new_factor_(Eigen::MatrixXd::Zero(dimension, dimension)) {
  const char jobz = 'V', uplo = 'L';
  const int query = -1;
  double work_size = 0;
  int integer_work_size = 0, info = 0;
  dsyevd_(&jobz, &uplo, &dimension_, axes_.data(), &dimension_, lengths_.data(), &work_size, &query,
          &integer_work_size, &query, &info);
  work_.resize(static_cast<std::size_t>(work_size));
  integer_work_.resize(static_cast<std::size_t>(integer_work_size));
}

void FullCovariance::Transform(const Eigen::MatrixXd& z, Eigen::MatrixXd* y) const {
  // Eq. 39 with L for B D, so that z serves as C^(-1/2) y: it is as long as that, and the
  // coordinates of both turn no faster than C changes.
  TriangularProduct(dimension_, population_, factor_.data(), z.data(), y->data());
}

void FullCovariance::Append(const CovarianceUpdate& update, const Eigen::MatrixXd& steps,
                            const Eigen::VectorXd& path) {
  // Eq. 47. Column 0 is the rank-one term.
  const StrategyParameters& p = update.parameters;
  waiting_decay_ *= update.decay;
  waiting_weights_.head(n_waiting_ * (population_ + 1)) *= update.decay;
  const Eigen::Index first = Eigen::Index{n_waiting_} * (population_ + 1);
  waiting_.col(first) = path;
  waiting_weights_[first] = p.c_1;
  for (int i = 0; i < population_; ++i) {
    waiting_.col(first + 1 + i) = steps.col(update.ranking[i]);
    waiting_weights_[first + 1 + i] = p.c_mu * ScaledWeight(update, i);
  }
  ++n_waiting_;
}

void FullCovariance::AddWaiting(Eigen::MatrixXd* matrix) {
  SymmetricProduct(dimension_, n_waiting_ * (population_ + 1), waiting_decay_,
                   waiting_weights_.data(), waiting_.data(), matrix->data());
  n_waiting_ = 0;
  waiting_decay_ = 1;
}

void FullCovariance::Update(const CovarianceUpdate& update) {
  Append(update, update.y, update.path_c);
  const bool new_factor = update.generation - factor_generation_ >= factor_interval_;
  const bool new_axes = update.generation - axes_generation_ >= axes_interval_;
  if (new_factor || new_axes || n_waiting_ == kMostWaiting) AddWaiting(&covariance_);
  if (new_factor) {
    factor_generation_ = update.generation;
    Factorise();
  }
  if (new_axes) {
    axes_generation_ = update.generation;
    FindAxes();
  }
}

void FullCovariance::AdaptedUpdate(const CovarianceUpdate& update, double old_sigma, double* sigma,
                                   AdaptiveRate* rate) {
  const double growth = (*sigma / old_sigma) * (*sigma / old_sigma);
  // In the coordinates of L^(-1) the old C is I and the steps are z.
  Eigen::MatrixXd change = Eigen::MatrixXd::Identity(dimension_, dimension_);
  Append(update, update.z, factor_.triangularView<Eigen::Lower>().solve(update.path_c));
  AddWaiting(&change);
  change = (growth * change.selfadjointView<Eigen::Lower>().toDenseMatrix() -
            Eigen::MatrixXd::Identity(dimension_, dimension_)) /
           std::sqrt(2.0);
  const double eta = rate->Adapt({change.data(), static_cast<std::size_t>(change.size())});

  const Eigen::MatrixXd old = covariance_;
  Append(update, update.y, update.path_c);
  AddWaiting(&covariance_);
  covariance_ = (1 - eta) * old + (eta * growth) * covariance_;
  factor_generation_ = update.generation;
  Factorise();
  // Sigma = sigma^2 C with det C = 1.
  const double scale = std::exp(factor_.diagonal().array().log().mean());
  *sigma = old_sigma * scale;
  covariance_ /= scale * scale;
  factor_ /= scale;
  lengths_ /= scale;
  if (update.generation - axes_generation_ >= axes_interval_) {
    axes_generation_ = update.generation;
    FindAxes();
  }
}

void FullCovariance::Factorise() {
  const SingleThreadedBlas single_threaded;
  const char uplo = 'L';
  int info = 0;
  for (int i = 0; i < dimension_; ++i) {  // what is above the diagonal stays zero
    std::copy_n(&covariance_(i, i), dimension_ - i, &new_factor_(i, i));
  }
  dpotrf_(&uplo, &dimension_, new_factor_.data(), &dimension_, &info);
  // A matrix that is no longer positive definite ends the run as ConditionCov.
  if (info != 0) {
    condition_ = std::numeric_limits<double>::infinity();
    return;
  }
  factor_.swap(new_factor_);
}

void FullCovariance::FindAxes() {
  axes_ = covariance_;
  const SingleThreadedBlas single_threaded;
  const char jobz = 'V', uplo = 'L';
  const int work_size = static_cast<int>(work_.size());
  const int integer_work_size = static_cast<int>(integer_work_.size());
  int info = 0;
  dsyevd_(&jobz, &uplo, &dimension_, axes_.data(), &dimension_, lengths_.data(), work_.data(),
          &work_size, integer_work_.data(), &integer_work_size, &info);
  const double smallest = lengths_[0], largest = lengths_[dimension_ - 1];
  condition_ =
      info == 0 && smallest > 0 ? largest / smallest : std::numeric_limits<double>::infinity();
  lengths_ = lengths_.cwiseMax(0.0).cwiseSqrt();
}

}  // namespace downpour
