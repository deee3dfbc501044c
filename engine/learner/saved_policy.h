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
  std::string kind;  // "nn": u = limit tanh(W1 tanh(W0 (features / input_scale) + b0) + b1)
  std::string task;
  std::string preset;
  int episode = 0;
  int hidden_units = 0;
  std::vector<std::string> features;  // (F) names, in the order of the policy's inputs
  std::vector<double> input_scale;    // (F)
  std::vector<std::string> actions;   // (A) names
  std::vector<double> action_limits;  // (A)
  std::vector<double> parameters;     // (P) W0 (hidden x F, row-major), b0, W1 (A x hidden), b1
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
// allowed: parameters finite, input_scale and action_limits also > 0.
SavedPolicy ReadPolicy(const std::filesystem::path& path);

// The policy function for `saved.parameters`. Throws InvalidInput if `saved` does not fit the task:
// its name, features, input scale, action limits or number of parameters; the message names the
// file that `saved` came from.
std::unique_ptr<Policy> MakePolicy(const SavedPolicy& saved, const Task& task);

}  // namespace downpour
