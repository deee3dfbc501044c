// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"

namespace downpour {

// A policy with its parameters, as learning ends with it: acts on states instead of features.
// Thread-safe.
class LearntPolicy {
 public:
  // `policy` is of `task`; parameters (P).
  LearntPolicy(Task task, std::shared_ptr<const Policy> policy, std::vector<double> parameters);

  // Writes the action (A), within the task's limits, for a state (E) as observed, in the units of
  // the task. `step`, from 0, is for policies that depend on time. Allocates.
  void Act(int step, std::span<const double> state, std::span<double> action) const;

  const Task& task() const { return task_; }
  const Policy& policy() const { return *policy_; }
  const std::vector<double>& parameters() const { return parameters_; }

 private:
  Task task_;
  std::shared_ptr<const Policy> policy_;
  std::vector<double> parameters_;
};

}  // namespace downpour
