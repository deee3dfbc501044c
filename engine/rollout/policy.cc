// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/policy.h"

#include <algorithm>

#include "engine/errors.h"
#include "engine/rollout/movement_primitive.h"
#include "engine/rollout/one_lane.h"
#include "kernels/gp_policy/gp_policy.h"
#include "kernels/linear_policy/linear_policy.h"
#include "kernels/movement_primitive/movement_primitive.h"

namespace downpour {
namespace {

constexpr int kMaxHiddenLayers = 8;
constexpr int kMaxHiddenUnits = 256;

// What the kernels multiply features by.
std::vector<double> InputFactors(const Task& task) {
  std::vector<double> factors;
  for (const double scale : task.policy_input_scale) factors.push_back(1 / scale);
  return factors;
}

class NeuralNetworkPolicy final : public Policy {
 public:
  NeuralNetworkPolicy(const Task& task, const PolicyOptions& options)
      : input_scale_(InputFactors(task)), limits_(task.action_limits) {
    shape_.units = options.hidden_units;
    shape_.units.insert(shape_.units.begin(), task.n_features());
    shape_.units.push_back(task.n_actions());
    shape_.activation = options.activation;
  }

  std::string kind() const override { return "nn"; }
  int n_parameters() const override { return shape_.n_parameters(); }
  int scratch_rows() const override { return shape_.scratch_rows(); }

  void ActTile(int, int n_lanes, const double* parameters, const double* features, double* scratch,
               double* actions) const override {
    MlpTile(shape_, n_lanes, parameters, input_scale_.data(), limits_.data(), features, scratch,
            actions);
  }

 private:
  MlpShape shape_;
  std::vector<double> input_scale_;
  std::vector<double> limits_;
};

class LinearPolicy final : public Policy {
 public:
  explicit LinearPolicy(const Task& task)
      : shape_{task.n_features(), task.n_actions()},
        input_scale_(InputFactors(task)),
        limits_(task.action_limits) {}

  std::string kind() const override { return "linear"; }
  int n_parameters() const override { return shape_.n_parameters(); }

  void ActTile(int, int n_lanes, const double* parameters, const double* features, double*,
               double* actions) const override {
    LinearPolicyTile(shape_, n_lanes, parameters, input_scale_.data(), limits_.data(), features,
                     actions);
  }

 private:
  LinearPolicyShape shape_;
  std::vector<double> input_scale_;
  std::vector<double> limits_;
};

class GpPolicy final : public Policy {
 public:
  GpPolicy(const Task& task, int points)
      : shape_{task.n_features(), points, task.n_actions()},
        input_scale_(InputFactors(task)),
        limits_(task.action_limits) {}

  std::string kind() const override { return "gp"; }
  int n_parameters() const override { return shape_.n_parameters(); }
  int scratch_rows() const override { return shape_.scratch_rows(); }

  void PrepareTile(int n_lanes, const double* parameters, double* scratch) const override {
    GpPolicyPrepareTile(shape_, n_lanes, parameters, scratch);
  }

  void ActTile(int, int n_lanes, const double*, const double* features, double* scratch,
               double* actions) const override {
    GpPolicyTile(shape_, n_lanes, input_scale_.data(), limits_.data(), features, scratch, actions);
  }

 private:
  GpPolicyShape shape_;
  std::vector<double> input_scale_;
  std::vector<double> limits_;
};

class DmpPolicy final : public Policy {
 public:
  DmpPolicy(const Task& task, int points)
      : horizon_(task.horizon),
        n_weights_(points + 1),
        response_(MovementPrimitiveResponse(task.horizon, points)),
        limits_(task.action_limits) {}

  std::string kind() const override { return "dmp"; }
  int n_parameters() const override { return static_cast<int>(limits_.size()) * n_weights_; }

  // A step beyond the horizon repeats its last one.
  void ActTile(int step, int n_lanes, const double* parameters, const double*, double*,
               double* actions) const override {
    const std::size_t row = static_cast<std::size_t>(std::min(step, horizon_ - 1));
    MovementPrimitiveTile(n_weights_, static_cast<int>(limits_.size()), n_lanes,
                          response_.data() + row * n_weights_, parameters, limits_.data(), actions);
  }

 private:
  int horizon_;
  int n_weights_;
  std::vector<double> response_;  // horizon x n_weights
  std::vector<double> limits_;
};

void CheckRange(const std::string& name, int value, int low, int high) {
  if (value >= low && value <= high) return;
  throw InvalidInput(name + " = " + std::to_string(value) + ": must be in [" + std::to_string(low) +
                     ", " + std::to_string(high) + "]");
}

}  // namespace

void Policy::Act(int step, std::span<const double> parameters, std::span<const double> features,
                 std::span<double> action) const {
  const AlignedVector<double> parameter_tile = ToOneLane(parameters);
  const AlignedVector<double> feature_tile = ToOneLane(features);
  AlignedVector<double> scratch(static_cast<std::size_t>(scratch_rows()) * kTileLanes);
  AlignedVector<double> action_tile(action.size() * kTileLanes);
  PrepareTile(1, parameter_tile.data(), scratch.data());
  ActTile(step, 1, parameter_tile.data(), feature_tile.data(), scratch.data(), action_tile.data());
  FromOneLane(action_tile, action);
}

void CheckPolicyOptions(const PolicyOptions& options) {
  const int n_layers = static_cast<int>(options.hidden_units.size());
  CheckRange("number of policy.hidden_units", n_layers, 1, kMaxHiddenLayers);
  for (const int units : options.hidden_units) {
    CheckRange("policy.hidden_units", units, 1, kMaxHiddenUnits);
  }
  CheckRange("policy.points", options.points, 0, kMaxPolicyPoints);
}

std::unique_ptr<Policy> MakePolicy(const Task& task, const PolicyOptions& options) {
  if (options.make) {
    std::unique_ptr<Policy> policy = options.make(task);
    if (policy == nullptr || policy->n_parameters() < 1) {
      throw InvalidInput("policy.make gave no policy: must be one with a parameter at least");
    }
    return policy;
  }
  CheckPolicyOptions(options);
  const int points = options.points == 0 ? task.policy_points : options.points;
  switch (options.kind) {
    case PolicyKind::kLinear:
      return std::make_unique<LinearPolicy>(task);
    case PolicyKind::kGp:
      return std::make_unique<GpPolicy>(task, points);
    case PolicyKind::kDmp:
      return std::make_unique<DmpPolicy>(task, points);
    case PolicyKind::kNeuralNetwork:
      break;
  }
  return std::make_unique<NeuralNetworkPolicy>(task, options);
}

}  // namespace downpour
