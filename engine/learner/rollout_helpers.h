// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "engine/gp/query_plan.h"
#include "engine/rollout/evaluator.h"
#include "engine/search/policy_search.h"

namespace downpour {

// Others that take a part of a search's rollouts off this process's evaluator, e.g. processes on
// other machines. Calls come from one thread.
class RolloutHelpers {
 public:
  virtual ~RolloutHelpers() = default;

  // Rollouts from now on have this model and these parameters of the task's prior, as
  // Evaluator::Evaluator takes them. Both are only valid during the call.
  virtual void SetModel(std::span<const QueryFactor> factors, std::span<const double> prior) = 0;

  // Evaluates the batch, a part of it by `evaluator`, which has the same model; the same bits as
  // evaluator->Evaluate alone. What the others have done is counted there (Evaluator::Count): with
  // `seconds` the wall time of the whole call for all of threads(). Throws Interrupted if the
  // search is to stop.
  virtual void Evaluate(const CandidateBatch& batch, Evaluator* evaluator,
                        std::span<double> returns) = 0;

  // Threads that evaluate, those of this process included.
  virtual int threads() const = 0;
};

}  // namespace downpour
