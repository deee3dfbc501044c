// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <vector>

#include "engine/gp/gp_model.h"
#include "kernels/philox/philox.h"
#include "tests/rollout/swing_fixture.h"

namespace downpour {

inline std::vector<double> RandomNumbers(int n, std::uint32_t stream) {
  std::vector<double> x(static_cast<std::size_t>(n));
  FillNormals({stream, 91}, 0, x.data(), x.size());
  return x;
}

// Exact GPs of SwingTask from points of its dynamics.
inline std::vector<ExactGp> SwingModel(int n_points) {
  Eigen::MatrixXd inputs(n_points, 4), targets(n_points, 2);
  std::vector<double> u(static_cast<std::size_t>(n_points) * 4);
  FillUniforms({1, 1}, 0, u.data(), u.size());
  for (int i = 0; i < n_points; ++i) {
    const double v = 4 * u[4 * i] - 2, angle = 6 * u[4 * i + 1] - 3,
                 torque = 5 * u[4 * i + 2] - 2.5;
    inputs.row(i) << v, std::cos(angle), std::sin(angle), torque;
    targets.row(i) << 0.1 * (torque - 5 * std::sin(angle)), 0.1 * v;
  }
  return {ExactGp(inputs, targets.col(0), {{3, 1.5, 1.5, 4}, 0.7, 0.05}),
          ExactGp(inputs, targets.col(1), {{2.5, 2, 1.7, 6}, 0.5, 0.03})};
}

}  // namespace downpour
