// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/movement_primitive.h"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

namespace downpour {
namespace {

// y at the ends of `horizon` steps by Runge-Kutta with many steps within each, g + f held.
std::vector<double> Integrate(int horizon, double goal, const std::vector<double>& weights) {
  constexpr int kSubsteps = 2000;
  const int n = static_cast<int>(weights.size());
  const double alpha = 25, beta = alpha / 4, phase_rate = std::log(100.0);
  std::vector<double> centres, outputs;
  for (int i = 0; i < n; ++i) centres.push_back(std::exp(-phase_rate * i / (n - 1)));
  std::array<double, 2> state = {0, 0};  // y, y'
  for (int t = 0; t < horizon; ++t) {
    const double x = std::exp(-phase_rate * t / horizon);
    double sum = 0, weighted = 0;
    for (int i = 0; i < n; ++i) {
      const double gap = i + 1 < n ? centres[i] - centres[i + 1] : centres[i - 1] - centres[i];
      const double psi = std::exp(-(x - centres[i]) * (x - centres[i]) / (gap * gap));
      sum += psi;
      weighted += psi * weights[i];
    }
    const double target = goal + x * weighted / sum;
    const auto slope = [&](const std::array<double, 2>& s) {
      return std::array<double, 2>{s[1], alpha * (beta * (target - s[0]) - s[1])};
    };
    const double h = 1.0 / horizon / kSubsteps;
    for (int k = 0; k < kSubsteps; ++k) {
      const auto moved = [&](const std::array<double, 2>& by, double factor) {
        return std::array<double, 2>{state[0] + factor * by[0], state[1] + factor * by[1]};
      };
      const auto k1 = slope(state), k2 = slope(moved(k1, h / 2)), k3 = slope(moved(k2, h / 2)),
                 k4 = slope(moved(k3, h));
      for (int i = 0; i < 2; ++i) state[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
    }
    outputs.push_back(state[0]);
  }
  return outputs;
}

TEST_CASE("movement primitive: the response solves its differential equation") {
  for (const int horizon : {1, 5, 40}) {
    const std::vector<double> weights = {1.5, -2, 0.25, 3};
    const double goal = 0.7;
    const std::vector<double> want = Integrate(horizon, goal, weights);
    const std::vector<double> response = MovementPrimitiveResponse(horizon, 4);
    REQUIRE(response.size() == static_cast<std::size_t>(horizon) * 5);
    for (int t = 0; t < horizon; ++t) {
      double y = goal * response[t * 5];
      for (int i = 0; i < 4; ++i) y += weights[i] * response[t * 5 + 1 + i];
      // Runge-Kutta errs by (25 h)^5 a step at most, and rounds 2000 times a step of the horizon.
      const double h = 25.0 / horizon / 2000;
      const double steps = 2000.0 * (t + 1);
      const double rounding = 20 * steps * std::numeric_limits<double>::epsilon();
      CHECK(std::abs(y - want[t]) <= 4 * (steps * std::pow(h, 5) + rounding));
    }
  }
}

TEST_CASE("movement primitive: the goal is reached, and equal weights act as the phase") {
  const int horizon = 40, n = 6;
  const std::vector<double> response = MovementPrimitiveResponse(horizon, n);
  // (1 + w0 s) exp(-w0 s) is left of the way at s = 1.
  CHECK(std::abs(response[39 * (n + 1)] - (1 - 13.5 * std::exp(-12.5))) <= 1e-14);
  const std::vector<double> one = MovementPrimitiveResponse(horizon, 1);
  for (int t = 0; t < horizon; ++t) {
    const auto row = response.begin() + t * (n + 1);
    CHECK(std::abs(std::accumulate(row + 1, row + n + 1, 0.0) - one[2 * t + 1]) <= 1e-15 * n);
  }
}

}  // namespace
}  // namespace downpour
