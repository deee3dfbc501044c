// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>
#include <limits>
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

// Each entry of `gradient` within 1e-6 of itself, or of 1e-2 of the largest, of central differences
// with two steps extrapolated (Richardson): error O(h^4) and eps / h.
template <typename Function>
void CheckGradient(const std::vector<double>& gradient, const std::vector<double>& x,
                   const Function& function) {
  const double h = std::pow(std::numeric_limits<double>::epsilon(), 0.2);
  const auto difference = [&](std::size_t p, double step) {
    std::vector<double> y = x;
    y[p] = x[p] + step;
    const double above = function(y);
    y[p] = x[p] - step;
    return (above - function(y)) / (2 * step);
  };
  double largest = 0;
  for (const double g : gradient) largest = std::max(largest, std::abs(g));
  CHECK(largest > 0);
  for (std::size_t p = 0; p < x.size(); ++p) {
    const double step = h * std::max(1.0, std::abs(x[p]));
    const double numeric = (4 * difference(p, step / 2) - difference(p, step)) / 3;
    CAPTURE(p);
    CAPTURE(gradient[p]);
    CAPTURE(numeric);
    CHECK(std::abs(gradient[p] - numeric) <= 1e-6 * std::max(std::abs(numeric), 1e-2 * largest));
  }
}

}  // namespace downpour
