// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/toml_task.h"

#include <doctest/doctest.h>

#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/rollout/dynamics_prior.h"
#include "engine/rollout/reward.h"
#include "kernels/philox/philox.h"
#include "tasks/registry.h"
#include "tests/tasks/task_folder.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// The built-in task as tasks/<name>/<name>.toml says it.
Task FromFile(const std::string& name) {
  return MakeTask((TasksFolder() / name / (name + ".toml")).string());
}

std::vector<std::string> Described(const std::vector<Variable>& variables) {
  std::vector<std::string> texts;
  for (const Variable& v : variables) texts.push_back(v.name + " in " + v.unit);
  return texts;
}

// One episode of random actions; rows of states, the start first.
struct Trajectory {
  std::vector<double> states, actions;
};
Trajectory RandomEpisode(const Task& task, std::uint32_t number) {
  Trajectory all;
  const std::size_t n = task.n_states(), m = task.n_actions();
  all.actions.resize(task.horizon * m);
  FillUniforms(StreamKey{3, number}, 0, all.actions.data(), all.actions.size());
  const std::unique_ptr<System> system = task.make_system();
  all.states.resize((task.horizon + 1) * n);
  const std::span<double> rows(all.states);
  system->Begin(1, task.start_mean, rows.first(n));
  for (int t = 0; t < task.horizon; ++t) {
    const std::span<double> action = std::span(all.actions).subspan(t * m, m);
    for (std::size_t i = 0; i < m; ++i) action[i] = (2 * action[i] - 1) * task.action_limits[i];
    system->Step(action, rows.subspan((t + 1) * n, n));
  }
  return all;
}

// Largest difference between the two tasks' rewards in the episode.
double RewardDifference(const Task& a, const Task& b, const Trajectory& episode) {
  const std::size_t n = a.n_states(), m = a.n_actions();
  double largest = 0;
  for (int t = 0; t < a.horizon; ++t) {
    const std::span state = std::span(episode.states).subspan((t + 1) * n, n);
    const std::span action = std::span(episode.actions).subspan(t * m, m);
    const double difference =
        ComputeReward(a, t, state, action) - ComputeReward(b, t, state, action);
    largest = std::fmax(largest, std::abs(difference));
  }
  return largest;
}

TEST_CASE("toml task: the built-in tasks from files have the same definition") {
  for (const std::string name : {"pendulum", "cartpole", "arm"}) {
    CAPTURE(name);
    const Task a = MakeTask(name), b = FromFile(name);
    CHECK(b.name == name);
    CHECK(b.preset == kOwnPreset);
    CHECK(b.description == a.description);
    CHECK(Described(b.states) == Described(a.states));
    CHECK(Described(b.feature_names) == Described(a.feature_names));
    CHECK(Described(b.actions) == Described(a.actions));
    REQUIRE(b.features.size() == a.features.size());
    for (int i = 0; i < a.n_features(); ++i) {
      CHECK(b.features[i].kind == a.features[i].kind);
      CHECK(b.features[i].state_index == a.features[i].state_index);
    }
    CHECK(b.action_limits == a.action_limits);
    CHECK(b.start_mean == a.start_mean);
    CHECK(b.start_std == a.start_std);
    CHECK(b.observation_std == a.observation_std);
    CHECK(b.policy_input_scale == a.policy_input_scale);
    CHECK(b.parameter_bound == a.parameter_bound);
    CHECK(b.policy_points == a.policy_points);
    CHECK(b.search_first_sigma == a.search_first_sigma);
    CHECK(b.search_restart_sigma == a.search_restart_sigma);
    CHECK(b.search_restart_decades == a.search_restart_decades);
    CHECK(b.control_period == a.control_period);
    CHECK(b.horizon == a.horizon);
    CHECK(b.learn_reward == a.learn_reward);
    CHECK(b.reward->InUnitInterval() == a.reward->InUnitInterval());
  }
}

TEST_CASE("toml task: trajectories of the built-in tasks from files have the same bits") {
  for (const std::string name : {"pendulum", "cartpole", "arm"}) {
    CAPTURE(name);
    for (std::uint32_t i = 0; i < 3; ++i) {
      CHECK(RandomEpisode(MakeTask(name), i).states == RandomEpisode(FromFile(name), i).states);
    }
  }
}

TEST_CASE("toml task: a prior is that of the compiled task; states of sensors can have none") {
  const std::string model = (TasksFolder() / "pendulum" / "pendulum.xml").string();
  const Task a = MakeTask("pendulum"), b = FromFile("pendulum");
  CHECK(b.make_prior(model, "")->Describe() == a.make_prior(model, "")->Describe());
  const std::filesystem::path examples = TasksFolder() / "examples";
  const Task pusher = MakeTask((examples / "pusher.toml").string());
  CHECK_THROWS_WITH_AS(pusher.make_prior((examples / "pusher.xml").string(), ""),
                       "prior.model: the task has states of sensor puck; allowed: tasks whose "
                       "states are positions and velocities of joints",
                       InvalidInput);
}

TEST_CASE("toml task: residuals are the compiled reward, description and bits") {
  for (const std::string name : {"pendulum", "cartpole"}) {
    CAPTURE(name);
    const Task a = MakeTask(name), b = FromFile(name);
    CHECK(b.reward->Describe() == a.reward->Describe());
    for (std::uint32_t i = 0; i < 3; ++i) {
      CHECK(RewardDifference(a, b, RandomEpisode(a, i)) == 0);
    }
  }
}

TEST_CASE("toml task: a distance of sites is the arm's reward") {
  const Task a = MakeTask("arm"), b = FromFile("arm");
  // arm.xml has the target in 8 digits: off by 1e-8 sqrt(3) / 2 at most, times the steepest slope
  // of exp(-d^2 / (2 width^2)).
  const double tolerance = 1e-8 * std::sqrt(3) / 2 * std::exp(-0.5) / 0.2;
  for (std::uint32_t i = 0; i < 10; ++i) {
    CHECK(RewardDifference(a, b, RandomEpisode(a, i)) <= tolerance);
  }
  const double eighth = std::numbers::pi / 8;
  const std::vector<double> there = {2 * eighth, eighth, eighth, eighth}, action(4, 0.0);
  CHECK(std::abs(ComputeReward(b, 0, there, action) - 1) <= tolerance);
}

TEST_CASE("toml task: a formula is the compiled reward but for rounding") {
  const TaskFolder folder;
  const std::string formula =
      "expression = \"exp(-(cart_position^2 + (cos_pole_angle + 1)^2 + sin_pole_angle^2)"
      " / (2 * 0.25^2))\"";
  const Task a = MakeTask("cartpole");
  const Task b = MakeTask(folder.Cartpole({{"residuals", ""}, {"width", formula}}));
  CHECK_FALSE(b.reward->InUnitInterval());
  for (std::uint32_t i = 0; i < 3; ++i) {
    const Trajectory episode = RandomEpisode(a, i);
    double largest = 0;  // of the exponent, whose terms are all positive
    for (std::size_t row = 0; row < episode.states.size(); row += 4) {
      largest = std::fmax(largest, std::pow(episode.states[row + 1], 2) + 4);
    }
    // x e^-x <= 1 for an exponent x with a relative error of some roundings; 1 + largest where
    // cos + 1 cancels.
    CHECK(RewardDifference(a, b, episode) <= 16 * kEps * (1 + 8 * largest));
  }
}

TEST_CASE("toml task: a formula of several lines is described in one") {
  const Task task = MakeTask((TasksFolder() / "examples/pusher.toml").string());
  const std::string text = task.reward->Describe();
  CHECK(text.starts_with("0.9 * exp(-((puck_x - goal.x)^2"));
  CHECK(text.find_first_of("\n\t") == std::string::npos);
  CHECK(text.find("  ") == std::string::npos);
}

TEST_CASE("toml task: unit_interval clamps a formula, and says so") {
  const TaskFolder folder;
  const Task task = MakeTask(folder.Cartpole(
      {{"residuals", ""}, {"width", "expression = \"cart_position\"\nunit_interval = true"}}));
  CHECK(task.reward->InUnitInterval());
  CHECK(task.reward->Describe() == "cart_position, clamped to [0, 1]");
  const std::vector<double> action = {0};
  for (const double x : {-3.0, 0.25, 7.0}) {
    const std::vector<double> state = {0, x, 0, 0};
    CHECK(ComputeReward(task, 0, state, action) == std::fmin(1, std::fmax(0, x)));
  }
}

TEST_CASE("toml task: the solved tests of the built-in tasks agree") {
  for (const std::string name : {"pendulum", "cartpole", "arm"}) {
    CAPTURE(name);
    const Task a = MakeTask(name), b = FromFile(name);
    const std::size_t n = a.n_states();
    int n_solved = 0;
    for (std::uint32_t trial = 0; trial < 200; ++trial) {
      // All states near the target, some nearer than others.
      std::vector<double> states((a.horizon + 1) * n);
      FillUniforms(StreamKey{5, trial}, 0, states.data(), states.size());
      const double spread = 0.002 * trial;
      for (std::size_t i = 0; i < states.size(); ++i) {
        states[i] = spread * (2 * states[i] - 1);
        if (name == "arm") states[i] += std::numbers::pi / (i % n == 0 ? 4 : 8);
        if (name != "arm" && i % n == n - 1)
          states[i] += (trial % 2 == 0 ? 1 : -3) * std::numbers::pi;
      }
      const bool solved = a.solved(states);
      n_solved += solved;
      CHECK(b.solved(states) == solved);
      CHECK(b.solved(std::span(states).last(10 * n)) == a.solved(std::span(states).last(10 * n)));
    }
    CHECK(n_solved > 20);
    CHECK(n_solved < 180);
  }
}

TEST_CASE("toml task: a state that is no number does not solve it") {
  const Task task = FromFile("pendulum");
  std::vector<double> states;
  for (int t = 0; t <= task.horizon; ++t) {
    states.push_back(0);
    states.push_back(std::numbers::pi);
  }
  CHECK(task.solved(states));
  states[2 * 35 + 1] = std::nan("");
  CHECK_FALSE(task.solved(states));
}

TEST_CASE("toml task: sensors and sites are where the joints put them, start and steps") {
  const Task task = MakeTask((TasksFolder() / "examples/pusher.toml").string());
  CHECK(task.start_mean == std::vector<double>{0, 0, 0.15, 0});  // the puck as the model has it
  const std::unique_ptr<System> system = task.make_system();
  std::vector<double> state(4);
  system->Begin(1, std::vector<double>{0.02, 0, 9, 9}, state);
  CHECK(state == std::vector<double>{0.02, 0, 0.15, 0});
  const std::vector<double> push = {0.3, 0};
  for (int t = 0; t < 10; ++t) system->Step(push, state);
  CHECK(state[0] > 0.2);
  // The finger and the puck touch: 0.03 m and 0.05 m, and what a soft contact gives way.
  CHECK(std::abs(state[2] - state[0] - 0.08) < 0.02);
}

TEST_CASE("toml task: the digest tells tasks apart, by their own text and by the model's") {
  const TaskFolder folder;
  const std::string file = folder.Cartpole({});
  const std::string first = MakeTask(file).model_digest;
  CHECK(first.size() == 16);
  CHECK(MakeTask(file).model_digest == first);
  folder.Cartpole({{"limit", "limit = 9"}});
  CHECK(MakeTask(file).model_digest != first);
  folder.Cartpole({});
  CHECK(MakeTask(file).model_digest == first);
  folder.WriteModel("damping=\"0.1\"", "damping=\"0.2\"");
  CHECK(MakeTask(file).model_digest != first);
}

}  // namespace
}  // namespace downpour
