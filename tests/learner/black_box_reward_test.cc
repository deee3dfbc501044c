// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <span>

#include "engine/learner/learner.h"
#include "engine/rollout/reward.h"
#include "tests/learner/test_run.h"

// A whole task of one's own, with a reward that has no gradient: what docs/rewards.md shows.

namespace downpour {
namespace {

// A point on a plane of 1 m by 1 m that goes where it is told to: state (x, y).
class Point final : public System {
 public:
  void Reset(std::span<const double> state) override { state_ = {state[0], state[1]}; }
  void Step(std::span<const double> action, std::span<double> state) override {
    for (int i = 0; i < 2; ++i) state[i] = state_[i] += 0.1 * action[i];
  }

 private:
  std::array<double, 2> state_ = {};
};

constexpr double kWall = 0.5;  // m, from y = -infinity to 0.4 m: the straight way is barred
constexpr double kWallTop = 0.4;

bool InWall(double x, double y) { return std::abs(x - kWall) < 0.1 && y < kWallTop; }
bool AtGoal(double x, double y) { return std::abs(x - 0.9) < 0.2 && std::abs(y) < 0.25; }

// +1 at the goal, -1 in the wall, 0 elsewhere: steps, without a slope anywhere.
class GoalAndWall final : public Reward {
 public:
  std::string Describe() const override {
    return "1 where |x - 0.9| < 0.2 and |y| < 0.25, -1 where |x - 0.5| < 0.1 and y < 0.4, else 0";
  }
  bool InUnitInterval() const override { return false; }
  void EvaluateTile(int, const double* states, const double*, const double*,
                    double* rewards) const override {
    const double* const x = states;
    const double* const y = states + kTileLanes;
    for (int lane = 0; lane < kTileLanes; ++lane) {
      rewards[lane] = AtGoal(x[lane], y[lane]) - InWall(x[lane], y[lane]);
    }
  }
};

Task DetourTask() {
  Task task;
  task.name = "detour";
  task.preset = "paper";
  task.states = {{"x", "m"}, {"y", "m"}};
  task.features = {{FeatureKind::kIdentity, 0}, {FeatureKind::kIdentity, 1}};
  task.feature_names = task.states;
  task.actions = {{"velocity_x", "m/s"}, {"velocity_y", "m/s"}};
  task.action_limits = {1, 1};
  task.start_mean = task.start_std = task.observation_std = {0, 0};
  task.policy_input_scale = {1, 1};
  task.horizon = 30;
  task.reward = std::make_shared<GoalAndWall>();
  task.solved = [](std::span<const double> states) {
    bool clear = true;
    for (std::size_t i = 0; i < states.size(); i += 2) {
      clear = clear && !InWall(states[i], states[i + 1]);
    }
    return clear && AtGoal(states[states.size() - 2], states[states.size() - 1]);
  };
  task.make_system = [] { return std::make_unique<Point>(); };
  return task;
}

TEST_CASE("black box: a policy goes round a wall to a goal by a reward without any slope") {
  LearnerOptions options;
  options.episodes = 3;
  options.seed = 1;
  options.threads = 2;
  options.search.evaluations = 20000;
  Learner learner(DetourTask(), options);
  while (!learner.done()) learner.RunEpisode({});
  const EpisodeRecord& last = learner.state().episodes.back();
  MESSAGE("predicted ", last.predicted_return, ", real ", last.real_return);
  CHECK(last.solved);
  // 0.7 m to the goal's edge and the detour take ten of the thirty steps at least.
  CHECK(last.real_return > 10);
  // What the learner believes and what happens are the same reward.
  CHECK(std::abs(last.predicted_return - last.real_return) < 3);
}

TEST_CASE("black box: a reward beyond the limit on the real system is named") {
  class Broken final : public Reward {
   public:
    std::string Describe() const override { return "broken"; }
    bool InUnitInterval() const override { return false; }
    void EvaluateTile(int step, const double*, const double*, const double*,
                      double* rewards) const override {
      std::fill_n(rewards, kTileLanes, step == 3 ? std::nan("") : 0);
    }
  };
  Task task = DetourTask();
  task.reward = std::make_shared<Broken>();
  Learner learner(task, {});
  CHECK(ErrorOf<InvalidInput>([&] { learner.RunEpisode({}); }) ==
        "episode 1, step 3: reward = nan on the real system: must be within +-1e+06");
  CHECK(learner.state().episodes.empty());
}

}  // namespace
}  // namespace downpour
