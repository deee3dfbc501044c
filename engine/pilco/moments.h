// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

namespace downpour {

// Mean and covariance of y = g(x), x Gaussian, and how they go together:
//   cov(x, y) = cov(x) slope,  slope = E[dy/dx]^T (Stein's lemma),
// so that no covariance is ever inverted and a singular one, zero included, is an ordinary input.
struct Moments {
  Eigen::VectorXd mean;        // (outputs)
  Eigen::MatrixXd covariance;  // outputs x outputs
  Eigen::MatrixXd slope;       // inputs x outputs
};

// In reverse mode a Moments holds a scalar's derivatives with respect to its entries, each taken
// for itself; of a covariance only the sum of (i, j) and (j, i) has a meaning. A GaussianAdjoint
// holds those with respect to a stage's Gaussian input; stages add to it.
struct GaussianAdjoint {
  Eigen::VectorXd mean;        // (inputs)
  Eigen::MatrixXd covariance;  // inputs x inputs

  explicit GaussianAdjoint(Eigen::Index n_inputs)
      : mean(Eigen::VectorXd::Zero(n_inputs)),
        covariance(Eigen::MatrixXd::Zero(n_inputs, n_inputs)) {}
};

// A Moments of zeros, to add to.
inline Moments ZeroMoments(Eigen::Index n_inputs, Eigen::Index n_outputs) {
  return {Eigen::VectorXd::Zero(n_outputs), Eigen::MatrixXd::Zero(n_outputs, n_outputs),
          Eigen::MatrixXd::Zero(n_inputs, n_outputs)};
}

}  // namespace downpour
