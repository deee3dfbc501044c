// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "engine/pilco/moments.h"
#include "kernels/philox/philox.h"

namespace downpour {

// S^1/2 for sampling, S of any rank.
inline Eigen::MatrixXd SquareRoot(const Eigen::MatrixXd& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(covariance);
  return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal();
}

// The worst deviation, in standard errors of the sample, of any claimed mean, covariance and cov(x,
// y) = S slope from those of `n` samples x ~ N(mean, covariance). y(x, &y, &variance) writes a
// sample's values and the variances that they have beside (zeros on entry). A statistic without
// spread must agree to rounding: its standard error counts as 1e-13 of its size at least. Without
// `with_slope` cov(x, y) is not looked at.
template <typename Function>
double WorstDeviation(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance,
                      const Moments& claimed, std::int64_t n, const Function& y,
                      bool with_slope = true) {
  constexpr std::int64_t kBlock = 1000;
  const Eigen::MatrixXd root = SquareRoot(covariance);
  const Eigen::Index in = mean.size(), out = claimed.mean.size();
  const Eigen::MatrixXd claimed_cross = covariance * claimed.slope;
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(out, 1 + out + in), squares = sum, sizes = sum;
  Eigen::MatrixXd normals(in, kBlock), sample(out, 1 + out + in);
  Eigen::VectorXd value(out), variance(out);
  for (std::int64_t first = 0; first < n; first += kBlock) {
    FillNormals({17, 23}, static_cast<std::uint32_t>(first / kBlock), normals.data(),
                static_cast<std::size_t>(normals.size()));
    const Eigen::MatrixXd shifts = root * normals;
    for (std::int64_t k = 0; k < kBlock; ++k) {
      const Eigen::VectorXd x = mean + shifts.col(k);
      variance.setZero();
      y(x, &value, &variance);
      sizes.col(0) = sizes.col(0).cwiseMax(value.cwiseAbs());
      const Eigen::VectorXd shift = value - claimed.mean;
      sample.col(0) = shift;
      sample.middleCols(1, out) = shift * shift.transpose() - claimed.covariance;
      sample.middleCols(1, out).diagonal() += variance;
      sample.rightCols(in) = shift * shifts.col(k).transpose() - claimed_cross.transpose();
      sum += sample;
      squares += sample.cwiseAbs2();
    }
  }
  const double largest = std::max(1.0, sizes.col(0).maxCoeff());
  const double floor = 1e-13 * largest * largest;
  double worst = 0;
  for (Eigen::Index i = 0; i < (with_slope ? sum.size() : out * (1 + out)); ++i) {
    const double average = sum(i) / static_cast<double>(n);
    const double spread = squares(i) / static_cast<double>(n) - average * average;
    const double error = std::sqrt(std::max(0.0, spread) / static_cast<double>(n));
    worst = std::max(worst, std::abs(average) / std::max(error, floor));
  }
  return worst;
}

}  // namespace downpour
