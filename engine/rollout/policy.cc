// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/policy.h"

#include <string>

#include "engine/errors.h"
#include "engine/rollout/one_lane.h"
#include "kernels/mlp/mlp.h"

namespace downpour {
namespace {

class NeuralNetworkPolicy final : public Policy {
 public:
  NeuralNetworkPolicy(const Task& task, int hidden_units)
      : shape_{task.n_features(), hidden_units, task.n_actions()}, limits_(task.action_limits) {
    for (const double scale : task.policy_input_scale) input_scale_.push_back(1 / scale);
  }

  int n_parameters() const override { return shape_.n_parameters(); }

  void ActTile(const double* parameters, const double* features, double* actions) const override {
    MlpTile(shape_, parameters, input_scale_.data(), limits_.data(), features, actions);
  }

  std::string kind() const override { return "nn"; }

 private:
  MlpShape shape_;
  std::vector<double> input_scale_;
  std::vector<double> limits_;
};

}  // namespace

void Policy::Act(std::span<const double> parameters, std::span<const double> features,
                 std::span<double> action) const {
  const AlignedVector<double> parameter_tile = ToOneLane(parameters);
  const AlignedVector<double> feature_tile = ToOneLane(features);
  AlignedVector<double> action_tile(action.size() * kTileLanes);
  ActTile(parameter_tile.data(), feature_tile.data(), action_tile.data());
  FromOneLane(action_tile, action);
}

std::unique_ptr<Policy> MakeNeuralNetworkPolicy(const Task& task, int hidden_units) {
  if (hidden_units < 1) {
    throw InvalidInput("policy.hidden_units = " + std::to_string(hidden_units) +
                       ": must be at least 1");
  }
  return std::make_unique<NeuralNetworkPolicy>(task, hidden_units);
}

}  // namespace downpour
