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
      steps_(dimension, population + 1),
      weighted_(dimension, population + 1),
      new_factor_(dimension, dimension) {
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

void FullCovariance::AddSteps(const CovarianceUpdate& update, const Eigen::MatrixXd& steps,
                              const Eigen::VectorXd& path, Eigen::MatrixXd* matrix) {
  // Eq. 47. Column 0 is the rank-one term.
  const StrategyParameters& p = update.parameters;
  steps_.col(0) = path;
  weighted_.col(0) = p.c_1 * path;
  for (int i = 0; i < population_; ++i) {
    const auto step = steps.col(update.ranking[i]);
    steps_.col(i + 1) = step;
    weighted_.col(i + 1) = (p.c_mu * ScaledWeight(update, i)) * step;
  }
  SymmetricProduct(dimension_, population_ + 1, update.decay, steps_.data(), weighted_.data(),
                   matrix->data());
}

void FullCovariance::Update(const CovarianceUpdate& update) {
  AddSteps(update, update.y, update.path_c, &covariance_);
  if (update.generation - factor_generation_ >= factor_interval_) {
    factor_generation_ = update.generation;
    Factorise();
  }
  if (update.generation - axes_generation_ >= axes_interval_) {
    axes_generation_ = update.generation;
    FindAxes();
  }
}

void FullCovariance::AdaptedUpdate(const CovarianceUpdate& update, double old_sigma, double* sigma,
                                   AdaptiveRate* rate) {
  const double growth = (*sigma / old_sigma) * (*sigma / old_sigma);
  // In the coordinates of L^(-1) the old C is I and the steps are z.
  Eigen::MatrixXd change = Eigen::MatrixXd::Identity(dimension_, dimension_);
  const Eigen::VectorXd path = factor_.triangularView<Eigen::Lower>().solve(update.path_c);
  AddSteps(update, update.z, path, &change);
  change = (growth * change.selfadjointView<Eigen::Lower>().toDenseMatrix() -
            Eigen::MatrixXd::Identity(dimension_, dimension_)) /
           std::sqrt(2.0);
  const double eta = rate->Adapt({change.data(), static_cast<std::size_t>(change.size())});

  const Eigen::MatrixXd old = covariance_;
  AddSteps(update, update.y, update.path_c, &covariance_);
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
  new_factor_ = covariance_;
  dpotrf_(&uplo, &dimension_, new_factor_.data(), &dimension_, &info);
  // A matrix that is no longer positive definite ends the run as ConditionCov.
  if (info != 0) {
    condition_ = std::numeric_limits<double>::infinity();
    return;
  }
  factor_.triangularView<Eigen::Lower>() = new_factor_;
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
