// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <limits>

#include "engine/search/strategy_parameters.h"

namespace downpour {

// A few direction vectors in place of the covariance matrix: LM-MA-ES of I. Loshchilov,
// T. Glasmachers and H.-G. Beyer, "Large Scale Black-box Optimization by Limited-Memory Matrix
// Adaptation" (IEEE TEVC 2018, arXiv 1705.06693). m = 4 + floor(3 ln P) vectors, each an average
// of the steps over four times as many generations as the one before, stretch N(0, I). O(m P) a
// candidate. The functions are those of FullCovariance. Not thread-safe.
class LimitedMemory {
 public:
  LimitedMemory(const StrategyParameters& parameters, int dimension, int population);

  void Transform(const Eigen::MatrixXd& z, Eigen::MatrixXd* y) const;
  void Update(const CovarianceUpdate& update);

  // Of the samples of this generation: C itself is never formed.
  double CoordinateStd(int i) const { return std_[i]; }
  double LargestStd() const { return std_.maxCoeff(); }
  // Unknown, so ConditionCov and NoEffectAxis never hold.
  double condition() const { return 1; }
  double AxisComponent(int, int) const { return std::numeric_limits<double>::infinity(); }

  template <typename Archive>
  void Visit(Archive& archive) {
    archive(n_updates_);
    archive(directions_);
  }

 private:
  int n_updates_ = 0;
  Eigen::MatrixXd directions_;  // (P x m) m_i
  Eigen::VectorXd c_d_, c_c_;   // (m) rates of the transformation and of the directions
  Eigen::VectorXd std_;         // (P)
};

}  // namespace downpour
