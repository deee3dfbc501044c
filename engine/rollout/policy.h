// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "engine/rollout/task.h"
#include "kernels/mlp/mlp.h"

namespace downpour {

// A parameterised policy u = pi(features, step | theta), evaluated for a tile of lanes that each
// have their own parameters: a black box to search and rollouts. A user's own is a class derived
// from this one (docs/policies.md); PolicyOptions::make hands it to the learner. Immutable: calls
// are thread-safe, on different scratch.
class Policy {
 public:
  virtual ~Policy() = default;
  // Names it in policy files; a run is resumed only with a policy of the same kind.
  virtual std::string kind() const = 0;
  virtual int n_parameters() const = 0;  // P, >= 1
  // Rows of kTileLanes doubles that a tile's scratch takes; always the same number.
  virtual int scratch_rows() const { return 0; }
  // Writes into `scratch` what ActTile needs of the parameters: called before the first ActTile of
  // a rollout, and again if its lanes are packed anew. Does not allocate.
  virtual void PrepareTile(int /*n_lanes*/, const double* /*parameters*/,
                           double* /*scratch*/) const {}
  // Actions of one step, numbered from 0: they depend on step, parameters and features alone.
  //   n_lanes     in [1, kTileLanes]; later lanes may be computed or left as they are, as may
  //               PrepareTile leave them
  //   parameters  P x kTileLanes; features F x kTileLanes; actions A x kTileLanes
  //   scratch     scratch_rows() x kTileLanes as PrepareTile left it, and ActTile's workspace; what
  //               PrepareTile left must stay
  // Aligned, no aliasing. |action_i| <= action limit. Does not allocate.
  virtual void ActTile(int step, int n_lanes, const double* parameters, const double* features,
                       double* scratch, double* actions) const = 0;
  // One action (A) for one feature vector (F): the same numbers as a lane of ActTile. Allocates.
  void Act(int step, std::span<const double> parameters, std::span<const double> features,
           std::span<double> action) const;
};

enum class PolicyKind { kNeuralNetwork, kLinear, kGp, kDmp };
inline constexpr std::array kPolicyKindNames = {"nn", "linear", "gp", "dmp"};
inline constexpr std::array kActivationNames = {"tanh", "relu"};

struct PolicyOptions {
  PolicyKind kind = PolicyKind::kNeuralNetwork;
  std::vector<int> hidden_units = {10};       // nn: of each hidden layer, 1 to 8 layers of [1, 256]
  Activation activation = Activation::kTanh;  // nn: of the hidden layers; the output's is tanh
  int points = 0;  // gp: pseudo-inputs, dmp: basis functions; [0, 200], 0: task.policy_points
  // If set: the user's own policy in place of the above.
  std::function<std::unique_ptr<Policy>(const Task&)> make = {};
};

// The policy of `options`; x = features / policy_input_scale, kappa(a) = 9/8 sin a + 1/8 sin 3a.
// Parameters in the order of the list; matrices are row-major.
//   nn      feed-forward network (paper section IV-A2), u = u_max tanh(W_L y_L + b_L), y_l =
//           activation(W_{l-1} y_{l-1} + b_{l-1}), y_0 = x: for each layer W (units x units of the
//           layer before), b
//   linear  u = u_max kappa(W x + b): W (A x F), b
//   gp      u = u_max kappa(k^T (K + 0.01 I)^-1 p) (paper section IV-A1), one GP an action on
//           shared pseudo-inputs: pseudo-inputs (points x F), in the units of x; pseudo-targets p
//           (A x points); log length-scales (A x F)
//   dmp     u_t = u_max kappa(y_t), y the output of a dynamic movement primitive, open-loop
//           (engine/rollout/movement_primitive.h): for each action its goal, then weights (points)
// Throws InvalidInput if an option is out of range.
std::unique_ptr<Policy> MakePolicy(const Task& task, const PolicyOptions& options);

// Throws InvalidInput that names the first option out of range as a TOML key.
void CheckPolicyOptions(const PolicyOptions& options);

}  // namespace downpour
