// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/se_mean.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>

namespace downpour {

// Deisenroth & Rasmussen 2011, Eq. 15: q_i = sigma_f^2 |S L^-2 + I|^-1/2 exp(-1/2 (x_i - m)^T P
// (x_i - m)); the slope is S^-1 times their Eq. 21's covariance, sum_i beta_i q_i P (x_i - m).
SeMean ExpectSe(const SeFunction& function, const Eigen::MatrixXd& centred,
                const Eigen::MatrixXd& covariance) {
  const Eigen::Index dim = centred.rows();
  const Eigen::VectorXd root = function.precisions.cwiseSqrt();
  // |I + S L^-2| = |I + L^-1 S L^-1|, and P = L^-1 (I + L^-1 S L^-1)^-1 L^-1.
  const Eigen::LLT<Eigen::MatrixXd> factor(Eigen::MatrixXd::Identity(dim, dim) +
                                           root.asDiagonal() * covariance * root.asDiagonal());
  SeMean result;
  double scale = function.signal_variance / factor.matrixLLT().diagonal().prod();
  if (factor.info() != Eigen::Success) scale = std::numeric_limits<double>::quiet_NaN();
  result.inverse = factor.solve(Eigen::MatrixXd(root.asDiagonal()));
  result.inverse.array().colwise() *= root.array();
  result.solved = result.inverse * centred;
  result.q = scale * (-0.5 * result.solved.cwiseProduct(centred).colwise().sum().array()).exp();
  result.terms = function.beta.cwiseProduct(result.q);
  result.mean = result.terms.sum();
  result.slope = result.solved * result.terms;
  return result;
}

void ExpectSeBackward(const SeFunction& function, const SeMean& result, double mean,
                      const Eigen::VectorXd& slope, GaussianAdjoint* input,
                      SeFunctionAdjoint* points) {
  // With y_i = P (x_i - m): d mu = sum t_i d log q_i, d slope = sum t_i (d log q_i y_i + d y_i).
  const Eigen::VectorXd by_q = (result.solved.transpose() * slope).array() + mean;
  const Eigen::VectorXd by_log_q = result.terms.cwiseProduct(by_q);
  const Eigen::VectorXd solved_slope = result.inverse * slope;
  const double sum = by_log_q.sum();
  // d log q_i = -y_i^T (dx_i - dm) + 1/2 tr((y_i y_i^T - P) dS),  dy_i = P (dx_i - dm) - P dS y_i.
  input->mean += result.solved * by_log_q - result.terms.sum() * solved_slope;
  const Eigen::MatrixXd by_covariance =
      (result.solved * by_log_q.asDiagonal() * result.solved.transpose() - sum * result.inverse) /
          2 -
      solved_slope * result.slope.transpose();
  input->covariance += by_covariance;
  if (points == nullptr) return;
  points->beta += result.q.cwiseProduct(by_q);
  points->points += solved_slope * result.terms.transpose();
  points->points -= result.solved * by_log_q.asDiagonal();
  // P depends on S + L^2, and |S L^-2 + I| = |S + L^2| / |L^2|.
  const Eigen::ArrayXd squares = 1 / function.precisions.array();
  points->log_lengthscales.array() += 2 * squares * by_covariance.diagonal().array() + sum;
}

}  // namespace downpour
