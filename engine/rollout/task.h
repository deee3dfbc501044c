// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "kernels/features/features.h"

namespace downpour {

// Most pseudo-inputs or basis functions of a policy.
inline constexpr int kMaxPolicyPoints = 200;

// A number of the task as a person reads it.
struct Variable {
  std::string name;  // e.g. "pole_angle"
  std::string unit;  // e.g. "rad"
};

class DynamicsPrior;  // engine/rollout/dynamics_prior.h
class Reward;         // engine/rollout/reward.h

// The real system, simulated or not. One object serves one thread.
class System {
 public:
  virtual ~System() = default;
  // Puts the system at `state` (E).
  virtual void Reset(std::span<const double> state) = 0;
  // Holds `action` (A, already clipped to the limits) for one control period, then writes the
  // noise-free state (E).
  virtual void Step(std::span<const double> action, std::span<double> state) = 0;

  // The rest is for hardware (engine/robot); a simulator keeps these defaults. Hardware throws
  // SystemFailure, or Interrupted on a request to stop, and has been told to stop by then.

  // True if states are measurements: they carry noise of their own, and no noise-free ones exist.
  virtual bool measured() const { return false; }
  // Begins an episode at `start` (E), or where hardware has to start, and writes that state (E).
  virtual void Begin(int episode, std::span<const double> start, std::span<double> state) {
    static_cast<void>(episode);
    Reset(start);
    std::copy(start.begin(), start.end(), state.begin());
  }
  // Of the last Step: the reward that the system itself gave (none: that of the task holds), and
  // whether the system ended the episode with it.
  virtual std::optional<double> reward() const { return std::nullopt; }
  virtual bool done() const { return false; }
  // The episode is over: no action holds any longer.
  virtual void End() noexcept {}
};

// All that the learner knows about a task. States are rows of E numbers in the order of
// `states`; times in seconds.
struct Task {
  std::string name;
  std::string description;
  std::string preset;  // "paper" or "original-code"
  std::vector<Variable> states;
  std::vector<Feature> features;
  std::vector<Variable> feature_names;  // as many as features
  std::vector<Variable> actions;
  std::vector<double> action_limits;       // |u_i| <= limit
  std::vector<double> start_mean;          // (E)
  std::vector<double> start_std;           // (E)
  std::vector<double> observation_std;     // (E), noise of what the policy and learner see
  std::vector<double> policy_input_scale;  // (F), the policy sees feature / scale
  double parameter_bound = 5;              // policy parameters lie in +-bound
  int policy_points = 10;                  // gp: pseudo-inputs, dmp: basis functions, by default
  // The search's first-run and restart widths that suit the task, by measurement.
  double search_first_sigma = 1;
  double search_restart_sigma = 5;
  double search_restart_decades = 1;
  double control_period = 0.1;  // s
  int horizon = 40;             // steps an episode
  std::shared_ptr<const Reward> reward;
  bool learn_reward = false;  // by default: the reward is unknown to the learner
  // True if `states` (rows of E noise-free states at t = 0, 1, ..., horizon) solve the task.
  std::function<bool(std::span<const double> states)> solved;
  std::string solved_description;
  // Digest of the text of the model that make_system simulates; "" for a system that is no model
  // file. A run is resumed only with the digest it was made with.
  std::string model_digest;
  // A new simulator of the real system. Throws InvalidInput if the MJCF cannot be used.
  std::function<std::unique_ptr<System>()> make_system;
  // What the dynamics are expected to be; nullptr: no change of the state in a step.
  std::shared_ptr<const DynamicsPrior> prior;
  // A prior from a simulator model of the user's and the list of its free parameters (docs/
  // priors.md). Throws InvalidInput if they cannot be used. Empty: the task knows none.
  std::function<std::shared_ptr<const DynamicsPrior>(const std::string& mjcf_file,
                                                     const std::string& free)>
      make_prior;

  int n_states() const { return static_cast<int>(states.size()); }
  int n_features() const { return static_cast<int>(features.size()); }
  int n_actions() const { return static_cast<int>(actions.size()); }
  int n_inputs() const { return n_features() + n_actions(); }  // of the model (paper: x tilde)
};

// Features (F) of one state (E): the same numbers as in a tile. Allocates.
void ComputeFeatures(const Task& task, std::span<const double> state, std::span<double> features);

}  // namespace downpour
