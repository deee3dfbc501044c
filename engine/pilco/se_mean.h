// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "engine/pilco/moments.h"

namespace downpour {

// One function f(x) = sum_i beta_i sigma_f^2 exp(-1/2 sum_d (x_d - x_id)^2 / l_d^2), the mean of an
// SE-ARD GP, without its points.
struct SeFunction {
  Eigen::VectorXd beta;        // (n)
  Eigen::VectorXd precisions;  // (D) 1 / l_d^2
  double signal_variance = 1;
};

// What mean and slope of f(x) under x ~ N(m, S) come from.
struct SeMean {
  double mean = 0;          // mu = beta^T q (Deisenroth & Rasmussen 2011, Eq. 14)
  Eigen::VectorXd slope;    // (D) E[df/dx]
  Eigen::VectorXd terms;    // (n) beta_i q_i
  Eigen::VectorXd q;        // (n)
  Eigen::MatrixXd inverse;  // D x D, P = (S + diag l^2)^-1
  Eigen::MatrixXd solved;   // D x n, P (x_i - m)
};

// `centred` is D x n: x_i - m. All NaN where S is so far from positive semi-definite that
// I + L^-1 S L^-1, L = diag l, has no Cholesky factor. Thread-safe, allocates.
SeMean ExpectSe(const SeFunction& function, const Eigen::MatrixXd& centred,
                const Eigen::MatrixXd& covariance);

// Derivatives with respect to the function itself.
struct SeFunctionAdjoint {
  Eigen::VectorXd beta;              // (n)
  Eigen::MatrixXd points;            // D x n
  Eigen::VectorXd log_lengthscales;  // (D)
};

// Reverse mode: adds what derivatives with respect to mean and slope come to; `points` may be
// nullptr. Thread-safe, allocates.
void ExpectSeBackward(const SeFunction& function, const SeMean& result, double mean,
                      const Eigen::VectorXd& slope, GaussianAdjoint* input,
                      SeFunctionAdjoint* points);

}  // namespace downpour
