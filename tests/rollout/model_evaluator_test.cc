// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/model_evaluator.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "engine/errors.h"
#include "tests/rollout/swing_fixture.h"

namespace downpour {
namespace {

// The fixture's model and policy as a ModelEvaluator takes them.
struct Swing {
  explicit Swing(int horizon = 6) : task(SwingTask(horizon)) {
    Dataset data;
    data.inputs.resize(30, 4);
    data.targets.resize(30, 2);
    std::vector<double> u(30 * 3);
    FillUniforms({1, 1}, 0, u.data(), u.size());
    for (int i = 0; i < 30; ++i) {
      const double v = 4 * u[3 * i] - 2, angle = 6 * u[3 * i + 1] - 3, torque = 5 * u[3 * i + 2];
      data.inputs.row(i) << v, std::cos(angle), std::sin(angle), torque - 2.5;
      data.targets.row(i) << 0.1 * (torque - 2.5 - 5 * std::sin(angle)), 0.1 * v;
    }
    const std::vector<Hyperparameters> hyperparameters(2, {{3, 1.5, 1.5, 4}, 0.7, 0.05});
    model = std::make_shared<MultiOutputGp>(data, hyperparameters, QueryPlanOptions{}, 1);
    policy = MakePolicy(task, {.hidden_units = {4}});
  }

  std::vector<double> Parameters(int n) const {
    std::vector<double> theta(static_cast<std::size_t>(n) * policy->n_parameters());
    FillNormals({2, 2}, 0, theta.data(), theta.size());
    return theta;
  }

  std::vector<double> Returns(const BlockFunctions& functions, int n, int rollouts,
                              const EvaluatorOptions& options = {}) const {
    const ModelEvaluator evaluator(model, task, policy, functions, rollouts, options);
    std::vector<double> returns(static_cast<std::size_t>(n) * rollouts);
    evaluator.Evaluate(Parameters(n), policy->n_parameters(), 7, returns);
    return returns;
  }

  // The policy, one lane at a time: the same numbers as in a tile.
  BlockPolicy OwnPolicy() const {
    return [this](int step, int lanes, const double* parameters, const double* features,
                  double* actions) {
      const int n_parameters = policy->n_parameters();
      std::vector<double> theta(n_parameters), x(3);
      for (int lane = 0; lane < lanes; ++lane) {
        for (int p = 0; p < n_parameters; ++p) theta[p] = parameters[p * lanes + lane];
        for (int f = 0; f < 3; ++f) x[f] = features[f * lanes + lane];
        policy->Act(step, theta, x, {actions + lane, 1});
      }
    };
  }

  BlockReward OwnReward() const {
    return
        [this](int step, int lanes, const double* states, const double* actions, double* rewards) {
          for (int lane = 0; lane < lanes; ++lane) {
            const double state[] = {states[lane], states[lanes + lane]};
            rewards[lane] = ComputeReward(task, step, state, {actions + lane, 1});
          }
        };
  }

  Task task;
  std::shared_ptr<const MultiOutputGp> model;
  std::shared_ptr<const Policy> policy;
};

TEST_CASE("model_evaluator: returns are those of the evaluator, whatever the slices") {
  const Swing swing;
  const int n = 700, rollouts = 9;  // three slices, cut within a candidate
  const std::vector<double> returns = swing.Returns({}, n, rollouts);
  Evaluator evaluator(swing.task, *swing.policy, swing.model->factors(), {.threads = 3});
  const std::vector<StreamKey> keys(n, DeriveKey(7, StreamPurpose::kEvaluate, {}));
  const std::vector<int> counts(n, rollouts), first(n, 0);
  std::vector<double> wanted(returns.size());
  evaluator.Evaluate(swing.Parameters(n), keys, counts, first, wanted);
  CHECK(returns == wanted);
}

TEST_CASE("model_evaluator: functions on blocks give the bits of policy and reward in tiles") {
  const Swing swing;
  for (const EvaluatorOptions& options :
       {EvaluatorOptions{}, EvaluatorOptions{.use_variance = false},
        EvaluatorOptions{.predict_noise = false}, EvaluatorOptions{.sample_clamp = 1}}) {
    const std::vector<double> wanted = swing.Returns({}, 33, 3, options);
    CHECK(swing.Returns({.policy = swing.OwnPolicy()}, 33, 3, options) == wanted);
    CHECK(swing.Returns({.reward = swing.OwnReward()}, 33, 3, options) == wanted);
    const BlockFunctions both{.policy = swing.OwnPolicy(), .reward = swing.OwnReward()};
    CHECK(swing.Returns(both, 33, 3, options) == wanted);
  }
}

TEST_CASE("model_evaluator: threads do not change a bit") {
  const Swing swing;
  const BlockFunctions functions{.reward = swing.OwnReward()};
  for (const BlockFunctions& each : {BlockFunctions{}, functions}) {
    const std::vector<double> one = swing.Returns(each, 50, 4);
    for (const int threads : {2, 5}) {
      EvaluatorOptions options;
      options.threads = threads;
      CHECK(swing.Returns(each, 50, 4, options) == one);
    }
  }
}

TEST_CASE("model_evaluator: features of one's own reach policy and model") {
  Swing swing;
  const std::vector<double> wanted = swing.Returns({}, 20, 2);
  const Task task = swing.task;
  BlockFunctions functions{.reward = swing.OwnReward()};
  functions.features = [task](int, int lanes, const double* states, double* features) {
    std::vector<double> row(3);
    for (int lane = 0; lane < lanes; ++lane) {
      const double state[] = {states[lane], states[lanes + lane]};
      ComputeFeatures(task, state, row);
      for (int f = 0; f < 3; ++f) features[f * lanes + lane] = row[f];
    }
  };
  CHECK(swing.Returns(functions, 20, 2) == wanted);
}

TEST_CASE("model_evaluator: a rollout is what evaluation summed") {
  const Swing swing;
  const int rollouts = 5, horizon = swing.task.horizon;
  const ModelEvaluator evaluator(swing.model, swing.task, swing.policy, {}, rollouts, {});
  const std::vector<double> theta = swing.Parameters(1);
  std::vector<double> returns(rollouts), states(rollouts * (horizon + 1) * 2),
      actions(rollouts * horizon), rewards(rollouts * horizon);
  evaluator.Evaluate(theta, swing.policy->n_parameters(), 11, returns);
  evaluator.Rollout(theta, 11, {states, actions, rewards});
  for (int r = 0; r < rollouts; ++r) {
    double sum = 0;
    std::vector<double> features(3), action(1);
    for (int t = 0; t < horizon; ++t) {
      const double* state = &states[(r * (horizon + 1) + t) * 2];
      ComputeFeatures(swing.task, {state, 2}, features);
      swing.policy->Act(t, theta, features, action);
      CHECK(actions[r * horizon + t] == action[0]);
      CHECK(rewards[r * horizon + t] == ComputeReward(swing.task, t, {state + 2, 2}, action));
      sum += rewards[r * horizon + t];
    }
    CHECK(sum == returns[r]);
  }
}

TEST_CASE(
    "model_evaluator: a reward beyond the limit is a divergence, NaN is the function's fault") {
  const Swing swing;
  BlockFunctions functions;
  functions.reward = [](int step, int lanes, const double*, const double*, double* rewards) {
    std::fill_n(rewards, lanes, 1.0);
    if (step == 2) rewards[1] = 2e6;
  };
  const std::vector<double> returns = swing.Returns(functions, 3, 1);
  CHECK(returns[0] == 6);
  CHECK(returns[1] == -6 * (Reward::kLimit + 1));
  const ModelEvaluator evaluator(swing.model, swing.task, swing.policy, functions, 2, {});
  std::vector<double> states(2 * 7 * 2), actions(2 * 6), rewards(2 * 6);
  evaluator.Rollout(swing.Parameters(1), 7, {states, actions, rewards});
  CHECK(std::isfinite(rewards[6 + 1]));
  CHECK(std::isnan(rewards[6 + 2]));
  CHECK(std::isnan(states[(7 + 3) * 2]));
  CHECK(evaluator.diverged_return() == returns[1]);
  for (const double bad : {std::nan(""), HUGE_VAL}) {
    functions.reward = [bad](int, int lanes, const double*, const double*, double* rewards) {
      std::fill_n(rewards, lanes, bad);
    };
    CHECK_THROWS_AS(swing.Returns(functions, 3, 1), InvalidInput);
  }
}

TEST_CASE("model_evaluator: actions are clipped, and the reward sees them clipped") {
  const Swing swing;
  BlockFunctions functions;
  functions.policy = [](int, int lanes, const double*, const double*, double* actions) {
    std::fill_n(actions, lanes, 100.0);
  };
  functions.reward = [](int, int lanes, const double*, const double* actions, double* rewards) {
    std::copy_n(actions, lanes, rewards);
  };
  for (const double sum : swing.Returns(functions, 3, 1)) CHECK(sum == 6 * 2.5);
}

TEST_CASE("model_evaluator: what a function throws reaches the caller, and stop is obeyed") {
  const Swing swing;
  BlockFunctions functions;
  functions.policy = [](int, int, const double*, const double*, double*) {
    throw std::logic_error("mine");
  };
  CHECK_THROWS_AS(swing.Returns(functions, 3, 1), std::logic_error);
  const std::atomic<bool> stop{true};
  for (const BlockFunctions& each :
       {BlockFunctions{}, BlockFunctions{.reward = swing.OwnReward()}}) {
    const ModelEvaluator evaluator(swing.model, swing.task, swing.policy, each, 1, {});
    std::vector<double> returns(2);
    CHECK_THROWS_AS(
        evaluator.Evaluate(swing.Parameters(2), swing.policy->n_parameters(), 0, returns, &stop),
        Interrupted);
  }
}

TEST_CASE("model_evaluator: what does not fit is refused") {
  const Swing swing;
  CHECK_THROWS_AS(ModelEvaluator(swing.model, swing.task, nullptr, {}, 1, {}), InvalidInput);
  CHECK_THROWS_AS(ModelEvaluator(swing.model, swing.task, swing.policy, {}, 0, {}), InvalidInput);
  Task task = swing.task;
  task.reward = nullptr;
  CHECK_THROWS_AS(ModelEvaluator(swing.model, task, swing.policy, {}, 1, {}), InvalidInput);
  task = swing.task;
  task.features.pop_back();
  CHECK_THROWS_AS(ModelEvaluator(swing.model, task, swing.policy, {}, 1, {}), InvalidInput);
  const ModelEvaluator evaluator(swing.model, swing.task, swing.policy, {}, 1, {});
  std::vector<double> returns(2);
  const std::vector<double> theta = swing.Parameters(2);
  CHECK_THROWS_AS(evaluator.Evaluate(theta, 3, 0, returns), InvalidInput);
  CHECK_THROWS_AS(
      evaluator.Evaluate(theta, swing.policy->n_parameters(), 0, std::span(returns).first(1)),
      InvalidInput);
}

}  // namespace
}  // namespace downpour
