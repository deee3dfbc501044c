// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "engine/gp/multi_output_gp.h"
#include "engine/rollout/block_functions.h"
#include "engine/rollout/block_rollouts.h"
#include "engine/rollout/evaluator.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"

namespace downpour {

// Evaluates many parameter vectors on a given model: the evaluator as other programs use it. It
// holds all that it needs; const calls are thread-safe and may be made from within the functions.
//
// Rollout r of seed s meets the same random numbers whatever the parameters, so that vectors are
// compared on equal terms, and a return depends on (model, parameters, s, r) alone. Bits do not
// depend on threads. With functions on blocks all lanes take a step together; without, tiles take
// all steps on their own.
class ModelEvaluator {
 public:
  // `policy` may be null if functions.policy is set; the task's reward may be if functions.reward
  // is, and its simulator is not used. rollouts >= 1 of each parameter vector. Throws InvalidInput
  // if sizes disagree or something is missing.
  ModelEvaluator(std::shared_ptr<const MultiOutputGp> model, Task task,
                 std::shared_ptr<const Policy> policy, BlockFunctions functions, int rollouts,
                 const EvaluatorOptions& options);

  const Task& task() const { return task_; }
  // Null with functions.policy; the number of its parameters is then what the caller makes it.
  const Policy* policy() const { return policy_.get(); }
  int rollouts() const { return rollouts_; }
  double diverged_return() const;

  // Sums of rewards, n x rollouts, of parameter vectors n x n_parameters, both row-major. `stop`
  // (may be null) is looked at all along; once it is true, throws Interrupted. Throws InvalidInput
  // if a size is wrong or a function gives a number that is not finite, and what functions throw.
  void Evaluate(std::span<const double> parameters, int n_parameters, std::uint64_t seed,
                std::span<double> returns, const std::atomic<bool>* stop = nullptr) const;

  // The rollouts of one parameter vector as they went (lane = rollout).
  void Rollout(std::span<const double> parameters, std::uint64_t seed,
               const TrajectoryBuffers& trajectories,
               const std::atomic<bool>* stop = nullptr) const;

 private:
  void CheckParameters(std::size_t size, int n_parameters) const;
  void EvaluateTiles(std::span<const double> parameters, StreamKey key, std::span<double> returns,
                     const std::atomic<bool>* stop) const;

  std::shared_ptr<const MultiOutputGp> model_;
  Task task_;
  std::shared_ptr<const Policy> policy_;
  BlockFunctions functions_;
  int rollouts_;
  EvaluatorOptions options_;
};

}  // namespace downpour
