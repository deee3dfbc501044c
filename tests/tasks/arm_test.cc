// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <vector>

#include "engine/rollout/reward.h"
#include "kernels/philox/philox.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr int kJoints = 4;
constexpr int kSamples = 1000;

using Vector = std::array<long double, 3>;
using State = std::array<double, kJoints>;

// The chain frame by frame: each rod is turned by the joints below it, innermost first.
Vector EndEffector(const State& q) {
  const long double rods[kJoints] = {0.123L, 0.317L, 0.202L, 0.1605L};
  Vector tip = {0, 0, 0};
  for (int joint = kJoints - 1; joint >= 0; --joint) {
    tip[2] += rods[joint];
    const long double angle = q[joint], c = std::cos(angle), s = std::sin(angle);
    if (joint == 0) {
      tip = {c * tip[0] - s * tip[1], s * tip[0] + c * tip[1], tip[2]};  // about z
    } else {
      tip = {c * tip[0] + s * tip[2], tip[1], c * tip[2] - s * tip[0]};  // about y
    }
  }
  tip[2] += 0.0545L;
  return tip;
}

long double DistanceToTarget(const State& q) {
  const Vector tip = EndEffector(q), target = EndEffector({kPi / 4, kPi / 8, kPi / 8, kPi / 8});
  long double squared = 0;
  for (int i = 0; i < 3; ++i) squared += (tip[i] - target[i]) * (tip[i] - target[i]);
  return std::sqrt(squared);
}

// kSamples x 2 kJoints uniform numbers in [-1, 1).
std::vector<double> Uniforms() {
  std::vector<double> u(kSamples * 2 * kJoints);
  FillUniforms(StreamKey{7, 4}, 0, u.data(), u.size());
  for (double& value : u) value = 2 * value - 1;
  return u;
}

double RewardOf(const Task& task, const State& q) {
  return ComputeReward(task, 0, q, std::vector<double>(kJoints, 0.0));
}

// A servo of gain k turns an inertia M by M / k less than it should for each rad/s that it has to
// change: k = 5000 N m s/rad, M at most 0.1 kg m^2 of the rotor and 0.2 of the links.
constexpr double kLag = 0.3 / 5000;

TEST_CASE("arm: joints move at the velocities asked for, within the servos' lag") {
  const Task task = MakeTask("arm");
  const std::unique_ptr<System> system = task.make_system();
  const std::vector<double> u = Uniforms();
  double largest = 0;
  for (int sample = 0; sample < kSamples; ++sample) {
    const double* const row = &u[sample * 2 * kJoints];
    State q, next;
    const std::vector<double> action(row + kJoints, row + 2 * kJoints);
    // Two steps from here stay off the limits.
    for (int i = 0; i < kJoints; ++i) q[i] = (i == 0 ? kPi - 0.3 : kPi / 2 - 0.3) * row[i];
    system->Reset(q);
    for (int step = 1; step <= 2; ++step) {
      system->Step(action, next);
      for (int i = 0; i < kJoints; ++i) {
        largest = std::max(largest, std::abs(next[i] - (q[i] + 0.1 * step * action[i])));
      }
    }
  }
  MESSAGE("largest difference ", largest, " rad, bound ", kLag);
  CHECK(largest <= kLag);
}

TEST_CASE(
    "arm: a change of velocity is over within a step, from which the next one does not tell") {
  const Task task = MakeTask("arm");
  const std::unique_ptr<System> moving = task.make_system(), resting = task.make_system();
  const std::vector<double> u = Uniforms();
  double largest = 0;
  for (int sample = 0; sample < 100; ++sample) {
    const double* const row = &u[sample * 2 * kJoints];
    const std::vector<double> before(row, row + kJoints), after(row + kJoints, row + 2 * kJoints);
    State q = {}, state, from_rest;
    moving->Reset(q);
    moving->Step(before, q);
    resting->Reset(q);
    moving->Step(after, state);
    resting->Step(after, from_rest);
    for (int i = 0; i < kJoints; ++i) {
      largest = std::max(largest, std::abs(state[i] - from_rest[i]));
    }
  }
  MESSAGE("largest difference ", largest, " rad");
  CHECK(largest <= kLag);
}

TEST_CASE("arm: joints stop at their limits and come off them at once") {
  const Task task = MakeTask("arm");
  const std::unique_ptr<System> system = task.make_system();
  for (const double side : {-1.0, 1.0}) {
    State q = {};
    system->Reset(q);
    std::vector<double> action(kJoints, side);
    for (int step = 0; step < task.horizon; ++step) system->Step(action, q);
    for (int i = 0; i < kJoints; ++i) {
      CHECK(std::abs(q[i] - side * (i == 0 ? kPi : kPi / 2)) < 0.01);
    }
    const State at_limit = q;
    action.assign(kJoints, -side);
    system->Step(action, q);
    for (int i = 0; i < kJoints; ++i) {
      CHECK(std::abs(q[i] - (at_limit[i] - 0.1 * side)) < 3e-3);
    }
  }
}

TEST_CASE("arm: both rewards are the closed form of the forward kinematics") {
  // |d| rounds by some eps of 1 m; the paper's exponent is 50 d, the other's 12.5 d^2, d < 1.6.
  constexpr double kTolerance = 1000 * std::numeric_limits<double>::epsilon();
  const Task paper = MakeTask("arm", "paper"), original = MakeTask("arm", "original-code");
  const std::vector<double> u = Uniforms();
  for (int sample = 0; sample < kSamples; ++sample) {
    State q;
    for (int i = 0; i < kJoints; ++i) q[i] = 4 * u[sample * 2 * kJoints + i];
    const long double d = DistanceToTarget(q);
    const auto wanted_paper = static_cast<double>(std::exp(-d / (2 * 0.1L * 0.1L)));
    const auto wanted = static_cast<double>(std::exp(-d * d / (2 * 0.2L * 0.2L)));
    CHECK(std::abs(RewardOf(paper, q) - wanted_paper) <= kTolerance);
    CHECK(std::abs(RewardOf(original, q) - wanted) <= kTolerance);
  }
  const State target = {kPi / 4, kPi / 8, kPi / 8, kPi / 8};
  for (const Task& task : {paper, original}) CHECK(std::abs(RewardOf(task, target) - 1) <= 1e-13);
  CHECK(RewardOf(paper, {}) < 1e-9);
  CHECK(RewardOf(original, {}) < 0.1);
}

// An episode of 41 states at `state`, row `at` at `other`.
std::vector<double> Episode(const State& state, int at, const State& other) {
  std::vector<double> rows;
  for (int t = 0; t <= 40; ++t) {
    const State& row = t == at ? other : state;
    rows.insert(rows.end(), row.begin(), row.end());
  }
  return rows;
}

TEST_CASE("arm: solved within 0.1 m throughout the last second, whatever the angles") {
  const Task task = MakeTask("arm");
  const State target = {kPi / 4, kPi / 8, kPi / 8, kPi / 8}, start = {};
  CHECK(task.solved(Episode(target, 29, start)));
  for (int t = 30; t <= 40; ++t) CHECK_FALSE(task.solved(Episode(target, t, start)));
  // Yawed by a half turn and pitched backwards: the same place.
  CHECK(task.solved(Episode({-3 * kPi / 4, -kPi / 8, -kPi / 8, -kPi / 8}, -1, start)));
  const std::vector<double> u = Uniforms();
  int n_solved = 0;
  for (int sample = 0; sample < kSamples; ++sample) {
    State q = target;
    for (int i = 0; i < kJoints; ++i) q[i] += 0.4 * u[sample * 2 * kJoints + i];
    const bool solved = DistanceToTarget(q) < 0.1L;
    n_solved += solved;
    CHECK(task.solved(Episode(q, -1, start)) == solved);
  }
  CHECK(n_solved > 100);
  CHECK(n_solved < kSamples - 100);
  State broken = target;
  broken[2] = std::nan("");
  CHECK_FALSE(task.solved(Episode(target, 33, broken)));
}

TEST_CASE("arm: limits, features and presets are those of the design; the reward is unknown") {
  const Task task = MakeTask("arm");
  CHECK(task.n_states() == 4);
  CHECK(task.n_features() == 8);
  CHECK(task.n_actions() == 4);
  CHECK(task.action_limits == std::vector<double>(4, 1.0));
  CHECK(task.observation_std == std::vector<double>(4, 0.0));
  CHECK(task.start_mean == std::vector<double>(4, 0.0));
  CHECK(task.start_std == std::vector<double>(4, 0.0));
  CHECK(task.policy_input_scale == std::vector<double>(8, 1.0));
  CHECK(task.parameter_bound == 1);
  CHECK(task.learn_reward);
  for (const char* known : {"pendulum", "cartpole"}) CHECK_FALSE(MakeTask(known).learn_reward);
  CHECK(task.preset == "original-code");
  CHECK(task.reward->Describe() != MakeTask("arm", "paper").reward->Describe());
}

}  // namespace
}  // namespace downpour
