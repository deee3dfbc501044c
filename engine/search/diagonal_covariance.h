// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cmath>

#include "engine/search/learning_rate.h"
#include "engine/search/strategy_parameters.h"

namespace downpour {

// The diagonal of the covariance matrix alone: R. Ros and N. Hansen, "A Simple Modification in
// CMA-ES Achieving Linear Time and Space Complexity" (PPSN 2008), with the active update. The
// functions are those of FullCovariance. P numbers. Not thread-safe.
class DiagonalCovariance {
 public:
  DiagonalCovariance(const StrategyParameters& parameters, int dimension, int population);

  void Transform(const Eigen::MatrixXd& z, Eigen::MatrixXd* y) const;
  void Update(const CovarianceUpdate& update);
  void AdaptedUpdate(const CovarianceUpdate& update, double old_sigma, double* sigma,
                     AdaptiveRate* rate);
  static Eigen::Index ChangeSize(int dimension) { return dimension; }

  double CoordinateStd(int i) const { return std::sqrt(variance_[i]); }
  double LargestStd() const { return std::sqrt(variance_.maxCoeff()); }
  double condition() const { return variance_.maxCoeff() / variance_.minCoeff(); }
  double AxisComponent(int axis, int i) const { return i == axis ? CoordinateStd(i) : 0; }

  template <typename Archive>
  void Visit(Archive& archive) {
    archive(variance_);
  }

 private:
  Eigen::VectorXd variance_;
};

}  // namespace downpour
