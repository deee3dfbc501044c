// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "engine/learner/learner.h"

namespace downpour {

// A learnt policy as policy.json holds it: all that running it takes.
struct SavedPolicy {
  std::string file;  // it was read from; for messages only
  std::string kind;  // "nn", "linear", "gp", "dmp" (engine/rollout/policy.h), or a user's own
  std::string task;
  std::string preset;
  int episode = 0;
  std::vector<int> hidden_units;              // nn
  Activation activation = Activation::kTanh;  // nn; in files without it: tanh
  int points = 0;                             // gp, dmp
  // What the policy acts on; files of one hidden layer from before there were other kinds lack
  // states, feature_map, control_period and horizon, which are then empty or 0.
  std::vector<std::string> states;    // (E) names
  std::vector<std::string> features;  // (F) names, in the order of the policy's inputs
  std::vector<Feature> feature_map;   // (F)
  std::vector<double> input_scale;    // (F)
  std::vector<std::string> actions;   // (A) names
  std::vector<double> action_limits;  // (A)
  double control_period = 0;          // s
  int horizon = 0;                    // steps of an episode
  std::vector<double> parameters;     // (P) in the order of engine/rollout/policy.h
  double predicted_return = 0;
  double real_return = 0;
  bool solved = false;
};

// The policy of one learnt episode (record.policy not empty).
SavedPolicy MakeSavedPolicy(const Task& task, const LearnerOptions& options, const Policy& policy,
                            const EpisodeRecord& record);

// Text of a policy file, one JSON object with the fields above.
std::string FormatPolicy(const SavedPolicy& policy);

// Reads a policy file. Throws FileError, or InvalidInput with the file, the field and what is
// allowed: parameters finite; input_scale, action_limits and control_period also > 0.
SavedPolicy ReadPolicy(const std::filesystem::path& path);

// The policy function for `saved.parameters`. Throws InvalidInput if `saved` does not fit the task
// (its name, features, input scale, action limits, for dmp the horizon, or number of parameters) or
// if its kind is a user's own; the message names the file that `saved` came from.
std::unique_ptr<Policy> MakePolicy(const SavedPolicy& saved, const Task& task);

// As much of the task as features and policy take, from the file alone: states, features, actions,
// limits, input scale, control period and horizon. `saved` must have states.
Task PolicyTask(const SavedPolicy& saved);

}  // namespace downpour
