// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/reward_moments.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>

namespace downpour {

// With y = (A f - b) / width ~ N(mu, V): E = |I + V|^-1/2 exp(-1/2 mu^T (I + V)^-1 mu).
double ExpectedReward(const SaturatingParameters& reward, const Eigen::VectorXd& mean,
                      const Eigen::MatrixXd& covariance, double weight, GaussianAdjoint* input) {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const auto rows = static_cast<Eigen::Index>(reward.b.size());
  if (rows == 0) return 1;
  const Eigen::MatrixXd a =
      Eigen::Map<const RowMajor>(reward.a.data(), rows, mean.size()) / reward.width;
  const Eigen::VectorXd mu =
      a * mean - Eigen::Map<const Eigen::VectorXd>(reward.b.data(), rows) / reward.width;
  const Eigen::MatrixXd v = a * covariance * a.transpose();
  const Eigen::LLT<Eigen::MatrixXd> factor(Eigen::MatrixXd::Identity(rows, rows) + v);
  if (factor.info() != Eigen::Success) return std::numeric_limits<double>::quiet_NaN();
  const Eigen::VectorXd solved = factor.solve(mu);
  const double root_determinant = factor.matrixLLT().diagonal().prod();
  const double value = std::exp(-mu.dot(solved) / 2) / root_determinant;
  if (input != nullptr) {
    const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(rows, rows));
    input->mean -= weight * value * (a.transpose() * solved);
    input->covariance +=
        weight * value / 2 * (a.transpose() * (solved * solved.transpose() - inverse) * a);
  }
  return value;
}

}  // namespace downpour
