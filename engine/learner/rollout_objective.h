// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "engine/gp/query_plan.h"
#include "engine/learner/rollout_helpers.h"
#include "engine/rollout/evaluator.h"
#include "engine/search/policy_search.h"

namespace downpour {

// What a policy search by rollouts maximises: one evaluator of all threads for whole batches, and
// one for each thread that takes runs through their generations on its own (SearchPolicy). Not
// thread-safe, but for own_objectives().
class RolloutObjective {
 public:
  // As Evaluator. helpers (may be null) take part in whole batches, which are then all there is.
  RolloutObjective(const Task& task, const Policy& policy, std::span<const QueryFactor> factors,
                   const EvaluatorOptions& options, std::span<const double> prior = {},
                   RolloutHelpers* helpers = nullptr);
  RolloutObjective(const RolloutObjective&) = delete;  // own_objectives() refer to it
  RolloutObjective& operator=(const RolloutObjective&) = delete;

  // Goes on with other factors, here and at the helpers. Not during a search's round.
  void SetFactors(std::span<const QueryFactor> factors);

  void Evaluate(const CandidateBatch& batch, std::span<double> returns);

  // One a thread, each for one thread at a time; the same bits as Evaluate. None for one thread,
  // with helpers, and if a factor is one for OpenBLAS, whose bits depend on the packing.
  std::span<const BatchObjective> own_objectives() const { return own_objectives_; }

  Evaluator* evaluator() { return &all_threads_; }
  int threads() const { return threads_; }  // the helpers' included

  // Of all evaluators. `waiting_seconds`: of the search so far (PolicySearchProgress); they count
  // as idle, and `seconds` is what a thread spent on average in rollouts or without work.
  EvaluatorStatistics Statistics(double waiting_seconds) const;

 private:
  RolloutHelpers* helpers_;
  std::vector<double> prior_;
  int threads_;
  Evaluator all_threads_;
  std::vector<Evaluator> own_;  // one a thread
  std::vector<BatchObjective> own_objectives_;
};

}  // namespace downpour
