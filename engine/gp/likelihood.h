// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "kernels/aligned.h"

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
  Eigen::MatrixXd inputs_;  // n x D, columns centred: the likelihood does not see a shift
  Eigen::VectorXd targets_;
  Eigen::MatrixXd scaled_;  // D columns of n rounded up to whole vectors
  AlignedVector<double> scratch_;
};

}  // namespace downpour
