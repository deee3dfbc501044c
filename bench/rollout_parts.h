// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <vector>

#include "engine/gp/query_plan.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"
#include "engine/search/policy_search.h"

namespace downpour {

// A copy of a batch that outlives the search which asked for it.
struct KeptBatch {
  explicit KeptBatch(const CandidateBatch& batch);
  int TotalRollouts() const;

  std::vector<double> parameters;
  std::vector<StreamKey> keys;
  std::vector<int> n_rollouts, first_rollout;
};

// What a rollout's time goes into.
enum RolloutPart {
  kPacking,  // parameters and keys into the tile, start states
  kPolicy,
  kQueries,  // means and variances of all outputs
  kSampling,
  kTransition,
  kFeatures,
  kReward,
  kRolloutParts
};
using PartSeconds = std::array<double, kRolloutParts>;

// Runs a batch as Evaluator does with default options, the same tiles through the same kernels, and
// reads the clock between kernels: seconds of each part, all threads together. Writes the returns
// (TotalRollouts), whose bits are those of Evaluator::Evaluate. The clock itself takes about 25 ns
// a kernel and step, 1 ns a query at most.
PartSeconds TimeRolloutParts(const Task& task, const Policy& policy,
                             std::span<const QueryFactor> factors, const KeptBatch& batch,
                             int threads, std::span<double> returns);

}  // namespace downpour
