// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/random_start.h"

#include <cmath>
#include <cstddef>
#include <string>

#include "engine/errors.h"

namespace downpour {
namespace {

// Standard deviation of pseudo-targets and weights.
constexpr double kTargetStd = 0.1;
// Length-scale of a sine or cosine; that of other features is 1.
constexpr double kAngleLengthscale = 0.7;
// Counters of the stream.
constexpr std::uint32_t kStates = 0, kTargets = 1;

std::vector<double> Normals(StreamKey key, std::uint32_t counter, double std, std::size_t n) {
  std::vector<double> z(n);
  FillNormals(key, counter, z.data(), n);
  for (double& x : z) x *= std;
  return z;
}

std::vector<double> DrawGp(const Task& task, int points, StreamKey key) {
  const std::size_t n_states = task.states.size(), n_features = task.features.size();
  const std::size_t n_points = static_cast<std::size_t>(points);
  std::vector<double> parameters;
  const std::vector<double> z = Normals(key, kStates, 1, n_points * n_states);
  std::vector<double> state(n_states), features(n_features);
  for (std::size_t i = 0; i < n_points; ++i) {
    for (std::size_t e = 0; e < n_states; ++e) {
      state[e] = task.start_mean[e] + task.start_std[e] * z[i * n_states + e];
    }
    ComputeFeatures(task, state, features);
    for (std::size_t f = 0; f < n_features; ++f) {
      parameters.push_back(features[f] / task.policy_input_scale[f]);
    }
  }
  const std::vector<double> targets =
      Normals(key, kTargets, kTargetStd, task.actions.size() * n_points);
  parameters.insert(parameters.end(), targets.begin(), targets.end());
  for (std::size_t a = 0; a < task.actions.size(); ++a) {
    for (std::size_t f = 0; f < n_features; ++f) {
      const bool identity = task.features[f].kind == FeatureKind::kIdentity;
      parameters.push_back(
          std::log((identity ? 1 : kAngleLengthscale) / task.policy_input_scale[f]));
    }
  }
  return parameters;
}

}  // namespace

std::vector<double> DrawPilcoStart(const Task& task, const PolicyOptions& policy, StreamKey key) {
  if (!policy.make && policy.kind == PolicyKind::kGp) {
    return DrawGp(task, policy.points == 0 ? task.policy_points : policy.points, key);
  }
  if (!policy.make && policy.kind == PolicyKind::kLinear) {
    const std::size_t n_actions = task.actions.size();
    std::vector<double> parameters =
        Normals(key, kTargets, kTargetStd, n_actions * task.features.size());
    parameters.resize(parameters.size() + n_actions, 0.0);
    return parameters;
  }
  throw InvalidInput("PILCO: the policy must be gp or linear");
}

}  // namespace downpour
