// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/se_pair.h"

#include <Eigen/Cholesky>
#include <limits>

namespace downpour {

SePair MakeSePair(const Eigen::VectorXd& precisions_a, const Eigen::VectorXd& precisions_b,
                  const Eigen::MatrixXd& covariance) {
  const Eigen::Index dim = covariance.rows();
  SePair pair;
  pair.precisions = precisions_a + precisions_b;
  const Eigen::VectorXd root = pair.precisions.cwiseSqrt();
  const Eigen::MatrixXd scaled = root.asDiagonal() * covariance * root.asDiagonal();
  const Eigen::LLT<Eigen::MatrixXd> factor(Eigen::MatrixXd::Identity(dim, dim) + scaled);
  pair.scale = factor.info() == Eigen::Success ? 1 / factor.matrixLLT().diagonal().prod()
                                               : std::numeric_limits<double>::quiet_NaN();
  // (S^-1 + W)^-1 = W^-1/2 B^-1 (B - I) W^-1/2.
  const Eigen::MatrixXd solved = factor.solve(scaled);
  const Eigen::VectorXd inverse_root = root.cwiseInverse();
  pair.g =
      inverse_root.asDiagonal() * ((solved + solved.transpose()) / 2) * inverse_root.asDiagonal();
  return pair;
}

// d log(scale Q_ij) = z^T (I - G W) dm + 1/2 z^T dG z - 1/2 tr((W - W G W) dS),
// dG = (I - G W) dS (I - W G).
void SePairDerivatives(const SePair& pair, const SePairSums& sums, const Eigen::MatrixXd& a,
                       const Eigen::MatrixXd& b, Eigen::VectorXd* by_mean,
                       Eigen::MatrixXd* by_covariance) {
  const Eigen::Index dim = pair.g.rows();
  const Eigen::MatrixXd wg = pair.precisions.asDiagonal() * pair.g;
  const Eigen::MatrixXd rest = Eigen::MatrixXd::Identity(dim, dim) - wg;  // I - W G
  *by_mean = rest * (a * sums.rows + b * sums.columns);
  Eigen::MatrixXd zz = a * sums.rows.asDiagonal() * a.transpose() +
                       b * sums.columns.asDiagonal() * b.transpose();  // sum_ij N_ij z z^T
  zz += sums.products + sums.products.transpose();
  Eigen::MatrixXd inverse = -wg * pair.precisions.asDiagonal();  // (S + W^-1)^-1
  inverse.diagonal() += pair.precisions;
  *by_covariance = (rest * zz * rest.transpose() - sums.rows.sum() * inverse) / 2;
}

}  // namespace downpour
