// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <variant>

#include "engine/gp/query_plan.h"

namespace downpour {

// What the factor answers at `inputs`, row by row: column 0 the means, 1 the variances.
inline Eigen::MatrixXd Answers(const QueryFactor& any, const Eigen::MatrixXd& inputs) {
  Eigen::MatrixXd answers(inputs.rows(), 2);
  std::visit(
      [&](const auto& factor) {
        AlignedVector<double> x(inputs.cols() * kTileLanes), mean(kTileLanes), variance(kTileLanes);
        AlignedVector<char> scratch(GpQueryScratchBytes(factor));
        for (Eigen::Index i = 0; i < inputs.rows(); ++i) {
          for (Eigen::Index d = 0; d < inputs.cols(); ++d) x[d * kTileLanes] = inputs(i, d);
          GpQueryTile(factor, 1, x.data(), scratch.data(), mean.data(), variance.data());
          answers.row(i) << mean[0], variance[0];
        }
      },
      any);
  return answers;
}

// No answer is NaN or infinite, no variance negative.
inline void CheckSound(const QueryFactor& factor, const Eigen::MatrixXd& inputs) {
  const Eigen::MatrixXd answers = Answers(factor, inputs);
  CHECK(answers.allFinite());
  CHECK(answers.col(1).minCoeff() >= 0);
}

}  // namespace downpour
