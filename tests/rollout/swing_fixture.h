// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "engine/rollout/evaluator.h"
#include "engine/rollout/reward.h"
#include "kernels/philox/philox.h"

namespace downpour {

// A swinging mass: state [velocity, angle], features [velocity, cos, sin], one action.
inline Task SwingTask(int horizon) {
  Task task;
  task.name = "swing";
  task.states = {{"velocity", "rad/s"}, {"angle", "rad"}};
  task.features = {{FeatureKind::kIdentity, 0}, {FeatureKind::kCosine, 1}, {FeatureKind::kSine, 1}};
  task.feature_names = {{"velocity", "rad/s"}, {"cos", "1"}, {"sin", "1"}};
  task.actions = {{"torque", "N m"}};
  task.action_limits = {2.5};
  task.start_mean = {0.1, -0.2};
  task.start_std = {0.05, 0};
  task.policy_input_scale = {10, 1, 1};
  task.horizon = horizon;
  task.reward = MakeSaturatingReward(task.feature_names, {0, 1, 0, 0, 0, 1}, {-1, 0}, 0.8);
  return task;
}

// Its learnt model and a policy.
struct Fixture {
  explicit Fixture(int horizon = 6, int n_points = 30, QueryBackend backend = QueryBackend::kFused)
      : task(SwingTask(horizon)) {
    policy = MakePolicy(task, {.hidden_units = {4}});
    Eigen::MatrixXd inputs(n_points, 4);
    Eigen::MatrixXd targets(n_points, 2);
    std::vector<double> u(n_points * 4);
    FillUniforms({1, 1}, 0, u.data(), u.size());
    for (int i = 0; i < n_points; ++i) {
      const double v = 4 * u[4 * i] - 2, angle = 6 * u[4 * i + 1] - 3,
                   torque = 5 * u[4 * i + 2] - 2.5;
      inputs.row(i) << v, std::cos(angle), std::sin(angle), torque;
      targets.row(i) << 0.1 * (torque - 5 * std::sin(angle)), 0.1 * v;
    }
    for (int e = 0; e < 2; ++e) {
      const ExactGp gp(inputs, targets.col(e), {{3, 1.5, 1.5, 4}, 0.7, 0.05});
      if (backend == QueryBackend::kBlas) {
        factors.push_back(MakeBlasFactor(gp));
      } else {
        factors.push_back(gp.Pack());
      }
    }
  }

  // n candidates with r rollouts each.
  std::vector<double> Returns(int n, int r, EvaluatorOptions options, int first_rollout = 0,
                              bool relaxed = false) {
    std::vector<double> theta(static_cast<std::size_t>(n) * policy->n_parameters());
    FillNormals({2, 2}, 0, theta.data(), theta.size());
    std::vector<StreamKey> keys;
    for (int c = 0; c < n; ++c) {
      keys.push_back(DeriveKey(7, StreamPurpose::kRollout, {static_cast<std::uint32_t>(c)}));
    }
    Evaluator evaluator(task, *policy, factors, options);
    std::vector<double> returns(static_cast<std::size_t>(n) * r);
    evaluator.Evaluate(theta, keys, std::vector<int>(n, r), std::vector<int>(n, first_rollout),
                       returns, {}, relaxed);
    statistics = evaluator.statistics();
    return returns;
  }

  Task task;
  std::unique_ptr<Policy> policy;
  std::vector<QueryFactor> factors;
  EvaluatorStatistics statistics;
};

}  // namespace downpour
