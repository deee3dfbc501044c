// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "engine/rollout/dynamics_prior.h"
#include "engine/rollout/task.h"

namespace downpour {

// A prior's predictors, one for each thread of a parallel region, and the time that they take.
class PriorPool {
 public:
  // At these parameters; no predictors if the task has no prior. Throws InvalidInput if the prior
  // has another number of parameters.
  PriorPool(const Task& task, std::span<const double> parameters, int threads);

  bool empty() const { return members_.empty(); }
  // Replaces the states of a tile's first n lanes by what the calling thread's predictor says of
  // them. Different threads may call at once. Does not allocate.
  void Advance(int n, const double* actions, double* states);
  // Spent in Advance so far, all threads together.
  double seconds() const;

 private:
  // A cache line of its own: threads count at the same time.
  struct alignas(64) Member {
    std::unique_ptr<PriorPredictor> predictor;
    double seconds = 0;
  };
  std::vector<Member> members_;
};

}  // namespace downpour
