// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <numeric>
#include <vector>

#include "engine/search/policy_search.h"

namespace downpour {

// A copy of a batch that outlives the search which asked for it.
struct KeptBatch {
  KeptBatch() = default;
  explicit KeptBatch(const CandidateBatch& batch)
      : parameters(batch.parameters.begin(), batch.parameters.end()),
        keys(batch.keys.begin(), batch.keys.end()),
        n_rollouts(batch.n_rollouts.begin(), batch.n_rollouts.end()),
        first_rollout(batch.first_rollout.begin(), batch.first_rollout.end()) {}
  int TotalRollouts() const { return std::accumulate(n_rollouts.begin(), n_rollouts.end(), 0); }

  std::vector<double> parameters;
  std::vector<StreamKey> keys;
  std::vector<int> n_rollouts, first_rollout;
};

}  // namespace downpour
