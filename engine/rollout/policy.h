// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "engine/rollout/task.h"

namespace downpour {

// A parameterised policy u = pi(features | theta), evaluated for a tile of lanes that each have
// their own parameters. Immutable: calls are thread-safe.
class Policy {
 public:
  virtual ~Policy() = default;
  virtual int n_parameters() const = 0;
  // parameters P x kTileLanes, features F x kTileLanes, actions A x kTileLanes; aligned, no
  // aliasing. |action_i| <= action limit. Does not allocate.
  virtual void ActTile(const double* parameters, const double* features, double* actions) const = 0;
  // One action (A) for one feature vector (F): the same numbers as a lane of ActTile.
  void Act(std::span<const double> parameters, std::span<const double> features,
           std::span<double> action) const;
  virtual std::string kind() const = 0;  // "nn"
};

// Feed-forward network, one hidden layer, tanh everywhere (paper section IV-A2):
// u = u_max tanh(W1 tanh(W0 (x / scale) + b0) + b1). Parameters in the order W0 (hidden x F,
// row-major), b0, W1 (A x hidden, row-major), b1.
std::unique_ptr<Policy> MakeNeuralNetworkPolicy(const Task& task, int hidden_units);

}  // namespace downpour
