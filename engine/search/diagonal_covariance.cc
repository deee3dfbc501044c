// SPDX-License-Identifier: Apache-2.0
#include "engine/search/diagonal_covariance.h"

namespace downpour {

DiagonalCovariance::DiagonalCovariance(const StrategyParameters&, int dimension, int)
    : variance_(Eigen::VectorXd::Ones(dimension)) {}

void DiagonalCovariance::Transform(const Eigen::MatrixXd& z, Eigen::MatrixXd* y) const {
  for (Eigen::Index c = 0; c < z.cols(); ++c) {
    y->col(c) = variance_.cwiseSqrt().cwiseProduct(z.col(c));
  }
}

// The diagonal of Eq. 47 of the tutorial.
void DiagonalCovariance::Update(const CovarianceUpdate& update) {
  const StrategyParameters& p = update.parameters;
  variance_ = update.decay * variance_ + p.c_1 * update.path_c.cwiseAbs2();
  for (int i = 0; i < p.weights.size(); ++i) {
    variance_ += p.c_mu * ScaledWeight(update, i) * update.y.col(update.ranking[i]).cwiseAbs2();
  }
}

void DiagonalCovariance::AdaptedUpdate(const CovarianceUpdate& update, double old_sigma,
                                       double* sigma, AdaptiveRate* rate) {
  const double growth = (*sigma / old_sigma) * (*sigma / old_sigma);
  const Eigen::VectorXd old = variance_;
  Update(update);
  const Eigen::VectorXd change =
      (growth * variance_.cwiseQuotient(old).array() - 1) / std::sqrt(2.0);
  const double eta = rate->Adapt({change.data(), static_cast<std::size_t>(change.size())});
  variance_ = (1 - eta) * old + (eta * growth) * variance_;
  const double scale = std::exp(variance_.array().log().mean());
  *sigma = old_sigma * std::sqrt(scale);
  variance_ /= scale;
}

}  // namespace downpour
