// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <span>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/rollout/reward.h"
#include "kernels/philox/philox.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kDegree = kPi / 180;

double RewardOf(const Task& task, const std::vector<double>& state) {
  return ComputeReward(task, 0, state, std::vector<double>(task.actions.size(), 0.0));
}

// Largest difference between the task's reward and exp(-d^2 / (2 width^2)) on random states.
template <typename SquaredDistance>
double RewardError(const Task& task, double width, const SquaredDistance& squared_distance) {
  const int n_states = task.n_states();
  std::vector<double> uniforms(1000 * n_states);
  FillUniforms(StreamKey{7, 7}, 0, uniforms.data(), uniforms.size());
  double largest = 0;
  for (std::size_t i = 0; i < uniforms.size(); i += n_states) {
    std::vector<double> state(uniforms.begin() + i, uniforms.begin() + i + n_states);
    for (double& variable : state) variable = 4 * variable - 2;
    state.back() *= kPi;
    const double expected = std::exp(-squared_distance(state) / (2 * width * width));
    largest = std::fmax(largest, std::abs(RewardOf(task, state) - expected));
  }
  return largest;
}

// The exponent is at most 8 d^2, and the terms of d^2, which may cancel, add up to at most 10: some
// roundings of 80 eps.
constexpr double kRewardTolerance = 200 * std::numeric_limits<double>::epsilon();

double UprightDistance(double angle) {
  return std::pow(std::cos(angle) + 1, 2) + std::pow(std::sin(angle), 2);
}

TEST_CASE("pendulum: both rewards are the closed form") {
  const auto distance = [](const std::vector<double>& y) { return UprightDistance(y[1]); };
  CHECK(RewardError(MakeTask("pendulum", "paper"), 0.25, distance) <= kRewardTolerance);
  CHECK(RewardError(MakeTask("pendulum", "original-code"), 0.5, distance) <= kRewardTolerance);
}

TEST_CASE("cartpole: both rewards are the closed form") {
  const auto paper = [](const std::vector<double>& y) {
    return y[1] * y[1] + UprightDistance(y[3]);
  };
  CHECK(RewardError(MakeTask("cartpole", "paper"), 0.25, paper) <= kRewardTolerance);
  const auto tip = [](const std::vector<double>& y) {
    const double x = y[1], l = 0.5;
    return x * x + 2 * x * l * std::sin(y[3]) + 2 * l * l + 2 * l * l * std::cos(y[3]);
  };
  CHECK(RewardError(MakeTask("cartpole", "original-code"), 0.25, tip) <= kRewardTolerance);
}

TEST_CASE(
    "swing-ups: the reward is 1 at the target and below 0.01 at the start, for both presets") {
  for (const std::string name : {"pendulum", "cartpole"}) {
    for (const std::string preset : {"paper", "original-code"}) {
      CAPTURE(name);
      CAPTURE(preset);
      const Task task = MakeTask(name, preset);
      std::vector<double> target(task.n_states(), 0.0);
      target.back() = kPi;
      CHECK(std::abs(RewardOf(task, target) - 1) <= kRewardTolerance);
      CHECK(RewardOf(task, task.start_mean) < 0.01);
    }
  }
}

TEST_CASE("tasks: every list has the length that the task's sizes say") {
  for (const std::string& name : TaskNames()) {
    for (const std::string preset : {"paper", "original-code"}) {
      CAPTURE(name);
      const Task task = MakeTask(name, preset);
      const std::size_t n_states = task.n_states(), n_features = task.n_features();
      CHECK(task.name == name);
      CHECK(task.preset == preset);
      CHECK(task.feature_names.size() == n_features);
      CHECK(task.policy_input_scale.size() == n_features);
      CHECK(task.action_limits.size() == task.actions.size());
      CHECK(task.start_mean.size() == n_states);
      CHECK(task.start_std.size() == n_states);
      CHECK(task.observation_std.size() == n_states);
      CHECK(task.reward->InUnitInterval());
      for (const Feature& feature : task.features) {
        CHECK(feature.state_index >= 0);
        CHECK(feature.state_index < task.n_states());
      }
      CHECK(task.control_period * task.horizon == doctest::Approx(4));
    }
  }
}

TEST_CASE("tasks: limits, noise, start and scales are those of the design") {
  const Task pendulum = MakeTask("pendulum");
  CHECK(pendulum.action_limits == std::vector<double>{2.5});
  CHECK(pendulum.observation_std == std::vector<double>{0, 0});
  CHECK(pendulum.start_std == std::vector<double>{0, 0});
  CHECK(pendulum.policy_input_scale == std::vector<double>{10, 1, 1});
  CHECK(pendulum.parameter_bound == 5);
  const Task cartpole = MakeTask("cartpole");
  CHECK(cartpole.preset == "paper");
  CHECK(cartpole.action_limits == std::vector<double>{10});
  CHECK(cartpole.observation_std == std::vector<double>(4, 0.01));
  CHECK(cartpole.start_std == std::vector<double>(4, 0.0));
  CHECK(MakeTask("cartpole", "original-code").start_std == std::vector<double>(4, 0.001));
  CHECK(cartpole.policy_input_scale == std::vector<double>{5, 5, 10, 1, 1});
  CHECK(cartpole.parameter_bound == 5);
}

// An episode of 41 rows at `state`, except for the rows [first, last] that are at `other`.
std::vector<double> Episode(const std::vector<double>& state, const std::vector<double>& other,
                            int first, int last) {
  std::vector<double> rows;
  for (int t = 0; t <= 40; ++t) {
    const std::vector<double>& row = t >= first && t <= last ? other : state;
    rows.insert(rows.end(), row.begin(), row.end());
  }
  return rows;
}

// The whole episode at `state`.
std::vector<double> Constant(const std::vector<double>& state) {
  return Episode(state, state, 0, -1);
}

TEST_CASE("solved: only the states of steps 30 to 40 count, and each of them does") {
  for (const std::string name : {"pendulum", "cartpole"}) {
    CAPTURE(name);
    const Task task = MakeTask(name);
    std::vector<double> hanging(task.n_states(), 0.0), upright(task.n_states(), 0.0);
    upright.back() = kPi;
    CHECK(task.solved(Constant(upright)));
    CHECK_FALSE(task.solved(Constant(hanging)));
    CHECK(task.solved(Episode(upright, hanging, 0, 29)));
    CHECK_FALSE(task.solved(Episode(upright, hanging, 0, 30)));
    for (int t = 30; t <= 40; ++t) CHECK_FALSE(task.solved(Episode(upright, hanging, t, t)));
  }
}

TEST_CASE("solved: the pole may be 10 degrees off upright modulo 2 pi, at any speed") {
  for (const std::string name : {"pendulum", "cartpole"}) {
    CAPTURE(name);
    const Task task = MakeTask(name);
    for (const double turns : {-3.0, -1.0, 0.0, 1.0, 2.0}) {
      for (const double side : {-1.0, 1.0}) {
        std::vector<double> state(task.n_states(), 0.0);
        state[task.n_states() - 2] = 20;
        state.back() = kPi + 2 * kPi * turns + side * 9.99 * kDegree;
        CHECK(task.solved(Constant(state)));
        state.back() = kPi + 2 * kPi * turns + side * 10.01 * kDegree;
        CHECK_FALSE(task.solved(Constant(state)));
      }
    }
  }
}

TEST_CASE("solved: the cart must be less than 0.1 m off, on both sides") {
  const Task task = MakeTask("cartpole");
  for (const double side : {-1.0, 1.0}) {
    CHECK(task.solved(Constant({0, side * 0.0999, 0, kPi})));
    CHECK_FALSE(task.solved(Constant({0, side * 0.1, 0, kPi})));
    CHECK_FALSE(task.solved(Episode({0, 0, 0, kPi}, {0, side * 0.2, 0, kPi}, 35, 35)));
  }
}

TEST_CASE("solved: NaN and less than a second of states are not solved") {
  const double nan = std::nan("");
  const Task pendulum = MakeTask("pendulum"), cartpole = MakeTask("cartpole");
  CHECK_FALSE(pendulum.solved(Episode({0, kPi}, {0, nan}, 33, 33)));
  CHECK_FALSE(cartpole.solved(Episode({0, 0, 0, kPi}, {0, nan, 0, kPi}, 33, 33)));
  CHECK_FALSE(pendulum.solved({}));
  const std::vector<double> rows = Constant({0, kPi});
  CHECK_FALSE(pendulum.solved(std::span(rows).first(10 * 2)));
}

}  // namespace
}  // namespace downpour
