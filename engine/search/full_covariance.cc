// SPDX-License-Identifier: Apache-2.0
#include "engine/search/full_covariance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "engine/lapack.h"
#include "engine/single_threaded_blas.h"

// Equation numbers are those of the tutorial (arXiv 1604.00772).
namespace downpour {

FullCovariance::FullCovariance(const StrategyParameters& parameters, int dimension, int population)
    : dimension_(dimension),
      population_(population),
      // C changes little within 1 / (c_1 + c_mu) generations. The tutorial waits a tenth of that
      // over P; twenty times longer needs no more evaluations (10-D and 20-D ellipsoid and
      // Rosenbrock) and, at P = 71 and lambda = 32, takes 49 us a generation in Tell instead of
      // 390.
      interval_(
          std::max(1, static_cast<int>(2 / (dimension * (parameters.c_1 + parameters.c_mu))))),
      covariance_(Eigen::MatrixXd::Identity(dimension, dimension)),
      axes_(covariance_),
      lengths_(Eigen::VectorXd::Ones(dimension)),
      root_(covariance_),
      selected_(dimension, population + 1),
      scaled_axes_(dimension, dimension) {
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
  // Eq. 39 with the symmetric root, so that C^(-1/2) y = z needs no product.
  const SingleThreadedBlas single_threaded;
  const char side = 'L', uplo = 'L';
  const double one = 1, zero = 0;
  dsymm_(&side, &uplo, &dimension_, &population_, &one, root_.data(), &dimension_, z.data(),
         &dimension_, &zero, y->data(), &dimension_);
}

void FullCovariance::AddSteps(const CovarianceUpdate& update, const Eigen::MatrixXd& steps,
                              const Eigen::VectorXd& path, Eigen::MatrixXd* matrix) {
  // Eq. 47, the positive and the negative terms each as one symmetric product. Column 0 is the
  // rank-one term.
  const StrategyParameters& p = update.parameters;
  selected_.col(0) = std::sqrt(p.c_1) * path;
  for (int i = 0; i < population_; ++i) {
    const double weight = p.c_mu * std::abs(ScaledWeight(update, i));
    selected_.col(i + 1) = std::sqrt(weight) * steps.col(update.ranking[i]);
  }
  const SingleThreadedBlas single_threaded;
  const char uplo = 'L', trans = 'N';
  const double one = 1, minus_one = -1;
  const int positive = p.parents + 1, negative = population_ - p.parents;
  dsyrk_(&uplo, &trans, &dimension_, &positive, &one, selected_.data(), &dimension_, &update.decay,
         matrix->data(), &dimension_);
  dsyrk_(&uplo, &trans, &dimension_, &negative, &minus_one, selected_.col(positive).data(),
         &dimension_, &one, matrix->data(), &dimension_);
}

void FullCovariance::Update(const CovarianceUpdate& update) {
  AddSteps(update, update.y, update.path_c, &covariance_);
  if (update.generation - eigen_generation_ < interval_) return;
  eigen_generation_ = update.generation;
  Decompose();
}

void FullCovariance::AdaptedUpdate(const CovarianceUpdate& update, double old_sigma, double* sigma,
                                   AdaptiveRate* rate) {
  const double growth = (*sigma / old_sigma) * (*sigma / old_sigma);
  // In the coordinates of C^(-1/2) the old C is I and the steps are z.
  Eigen::MatrixXd change = Eigen::MatrixXd::Identity(dimension_, dimension_);
  const Eigen::VectorXd path = axes_ * (axes_.transpose() * update.path_c).cwiseQuotient(lengths_);
  AddSteps(update, update.z, path, &change);
  change = (growth * change.selfadjointView<Eigen::Lower>().toDenseMatrix() -
            Eigen::MatrixXd::Identity(dimension_, dimension_)) /
           std::sqrt(2.0);
  const double eta = rate->Adapt({change.data(), static_cast<std::size_t>(change.size())});

  const Eigen::MatrixXd old = covariance_;
  AddSteps(update, update.y, update.path_c, &covariance_);
  covariance_ = (1 - eta) * old + (eta * growth) * covariance_;
  eigen_generation_ = update.generation;
  Decompose();
  // Sigma = sigma^2 C with det C = 1.
  const double scale = std::exp(lengths_.array().log().mean());
  *sigma = old_sigma * scale;
  covariance_ /= scale * scale;
  lengths_ /= scale;
  root_ /= scale;
}

void FullCovariance::Decompose() {
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

}  // namespace downpour
