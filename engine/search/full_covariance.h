// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <vector>

#include "engine/search/learning_rate.h"
#include "engine/search/strategy_parameters.h"

namespace downpour {

// The whole covariance matrix C of CMA-ES (Hansen, arXiv 1604.00772), sampled by its Cholesky
// factor, which is formed anew when C has changed enough, in every generation if rates are adapted;
// principal axes serve the stopping criteria alone and follow C more slowly. The steps of up to 8
// generations wait until they are added to C together. 4 P^2 numbers, and 8 P lambda. Not
// thread-safe.
class FullCovariance {
 public:
  FullCovariance(const StrategyParameters& parameters, int dimension, int population);

  // y = L z for every column, L L^T = C.
  void Transform(const Eigen::MatrixXd& z, Eigen::MatrixXd* y) const;
  void Update(const CovarianceUpdate& update);
  // As much of the update of Sigma = sigma^2 C, where *sigma is the new step size and old_sigma the
  // one before, as `rate` allows; splits the outcome into C of determinant 1 and *sigma.
  void AdaptedUpdate(const CovarianceUpdate& update, double old_sigma, double* sigma,
                     AdaptiveRate* rate);
  // Numbers that `rate` above averages.
  static Eigen::Index ChangeSize(int dimension) { return Eigen::Index{dimension} * dimension; }

  // By the C of at most 7 generations ago.
  double CoordinateStd(int i) const { return std::sqrt(covariance_(i, i)); }
  double LargestStd() const { return lengths_.maxCoeff(); }
  double condition() const { return condition_; }
  // Coordinate i of principal axis `axis`, one standard deviation long.
  double AxisComponent(int axis, int i) const { return lengths_[axis] * axes_(i, axis); }

  template <typename Archive>
  void Visit(Archive& archive) {
    archive(factor_generation_);
    archive(axes_generation_);
    archive(condition_);
    archive(covariance_);
    archive(factor_);
    archive(axes_);
    archive(lengths_);
    archive(n_waiting_);
    n_waiting_ = std::clamp(n_waiting_, 0, kMostWaiting - 1);
    archive(waiting_decay_);
    archive(waiting_weights_);
    archive(waiting_);
  }

 private:
  static constexpr int kMostWaiting = 8;

  void Factorise();
  void FindAxes();
  // The columns `steps` and the path wait with their weights in Eq. 47.
  void Append(const CovarianceUpdate& update, const Eigen::MatrixXd& steps,
              const Eigen::VectorXd& path);
  // Adds all that waits to the lower triangle of a matrix.
  void AddWaiting(Eigen::MatrixXd* matrix);

  int dimension_, population_;
  int factor_interval_, axes_interval_;  // generations
  int factor_generation_ = 0, axes_generation_ = 0;
  double condition_ = 1;
  Eigen::MatrixXd covariance_;  // C, lower triangle
  Eigen::MatrixXd factor_;      // L as of factor_generation_, zeros above the diagonal
  Eigen::MatrixXd axes_;        // B, columns are eigenvectors of C as of axes_generation_
  Eigen::VectorXd lengths_;     // D, square roots of the eigenvalues
  // Generations that C lacks: it is to be multiplied by the decay, and columns w y y^T (P x
  // 8 (lambda + 1)) are to be added.
  int n_waiting_ = 0;
  double waiting_decay_ = 1;
  Eigen::VectorXd waiting_weights_;
  Eigen::MatrixXd waiting_;
  // Scratch.
  Eigen::MatrixXd new_factor_;
  std::vector<double> work_;
  std::vector<int> integer_work_;
};

}  // namespace downpour
