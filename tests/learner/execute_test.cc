// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/execute.h"

#include <doctest/doctest.h>

#include "tests/learner/test_run.h"

namespace downpour {
namespace {

constexpr StreamKey kStart = {1, 2};
constexpr StreamKey kNoise = {3, 4};

double Normal(StreamKey key, std::uint32_t counter, std::size_t index) {
  double z[2];
  FillNormals(key, counter, z, 2);
  return z[index];
}

TEST_CASE("execute: observations are the states plus one draw a time, states follow the system") {
  const Task task = PointMassTask();
  PointMass system;
  std::vector<std::vector<double>> seen;
  const Execution execution =
      ExecuteEpisode(task, system, 3, kStart, kNoise,
                     [&](int step, std::span<const double> features, std::span<double> action) {
                       seen.emplace_back(features.begin(), features.end());
                       action[0] = step - 3.0;  // -3 is beyond the limit
                     });
  REQUIRE(execution.transitions.size() == 5);
  double state[2];
  for (std::size_t e = 0; e < 2; ++e) state[e] = task.start_std[e] * Normal(kStart, 0, e);
  double real_return = 0;
  for (int step = 0; step < 5; ++step) {
    const Transition& t = execution.transitions[step];
    CHECK(t.episode == 3);
    CHECK(t.step == step);
    CHECK(t.observation == seen[step]);
    const double action = std::max(step - 3.0, -2.0);
    CHECK(t.action[0] == action);
    for (std::size_t e = 0; e < 2; ++e) {
      const double noise = task.observation_std[e] * Normal(kNoise, step, e);
      CHECK(t.observation[e] == doctest::Approx(state[e] + noise).epsilon(1e-12));
    }
    state[1] += 0.1 * state[0];
    state[0] += 0.1 * action;
    for (std::size_t e = 0; e < 2; ++e) CHECK(t.next_state[e] == state[e]);
    const double miss = state[1] - 1;
    CHECK(t.reward == doctest::Approx(std::exp(-miss * miss / (2 * 0.5 * 0.5))).epsilon(1e-12));
    real_return += t.reward;
    if (step > 0) CHECK(t.observation == execution.transitions[step - 1].next_observation);
  }
  CHECK(execution.real_return == real_return);
}

TEST_CASE("execute: solved sees the start and every noise-free state") {
  Task task = PointMassTask();
  std::vector<double> seen;
  task.solved = [&](std::span<const double> states) {
    seen.assign(states.begin(), states.end());
    return true;
  };
  PointMass system;
  const Execution execution =
      ExecuteEpisode(task, system, 1, kStart, kNoise,
                     [](int, std::span<const double>, std::span<double> action) { action[0] = 1; });
  CHECK(execution.solved);
  REQUIRE(seen.size() == 2 * 6);
  CHECK(seen[1] == task.start_std[1] * Normal(kStart, 0, 1));
  for (int step = 0; step < 5; ++step) {
    CHECK(seen[2 * (step + 1)] == execution.transitions[step].next_state[0]);
    CHECK(seen[2 * (step + 1) + 1] == execution.transitions[step].next_state[1]);
  }
}

TEST_CASE("execute: a system or policy that is not finite is named") {
  class Broken : public PointMass {
   public:
    void Step(std::span<const double> action, std::span<double> state) override {
      PointMass::Step(action, state);
      if (++steps_ == 3) state[1] = std::numeric_limits<double>::quiet_NaN();
    }
    int steps_ = 0;
  };
  const Task task = PointMassTask();
  Broken system;
  CHECK(ErrorOf<InvalidInput>([&] {
          ExecuteEpisode(task, system, 4, kStart, kNoise,
                         [](int, std::span<const double>, std::span<double> a) { a[0] = 0; });
        }) == "episode 4, step 2: position, \"x\" = nan on the real system: must be finite");
  CHECK(ErrorOf<InvalidInput>([&] {
          ExecuteEpisode(task, system, 4, kStart, kNoise,
                         [](int, std::span<const double>, std::span<double> a) {
                           a[0] = std::numeric_limits<double>::infinity();
                         });
        }) == "episode 4, step 0: force = inf on the real system: must be finite");
}

}  // namespace
}  // namespace downpour
