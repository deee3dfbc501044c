// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "engine/gp/hyperparameters.h"

namespace downpour {

// Log marginal likelihood of one SE-ARD GP and its gradient with respect to
// (log l_1 ... log l_D, log sigma_f, log sigma_n) (Rasmussen & Williams 2006, Eq. 5.8 and 5.9).
// Holds the workspace, so that evaluations do not allocate. One object serves one thread.
class LogLikelihood {
 public:
  // inputs n x D, targets (n). Throws InvalidInput for sizes that disagree or non-finite data.
  LogLikelihood(const Eigen::MatrixXd& inputs, const Eigen::VectorXd& targets);

  // `log_parameters` and `gradient` (nullptr: none) have D + 2 entries. Returns -infinity, gradient
  // zero, where K has no Cholesky factor in fp64 or the result is not finite.
  double operator()(const double* log_parameters, double* gradient);

 private:
  bool Factorise(const double* log_parameters);
  void Gradient(const double* log_parameters, double* gradient);

  // n x (D + 1): columns centred (the likelihood does not see a shift), then a column of ones.
  Eigen::MatrixXd inputs_;
  Eigen::VectorXd targets_;
  Eigen::MatrixXd scaled_;      // n x D
  Eigen::MatrixXd covariance_;  // noise-free K, lower triangle
  Eigen::MatrixXd factor_;      // K + noise, then L, then its inverse's lower triangle, then W
  Eigen::VectorXd alpha_;
  Eigen::MatrixXd product_;  // n x (D + 1)
};

}  // namespace downpour
