// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "engine/search/policy_search.h"

namespace downpour {

// Which of the final means of a search's runs is best. All are screened by a few rollouts; the
// best kFinalists of them, candidate 0 always among them, are compared by `final_rollouts`, of
// which the screening ones are the first. Every candidate meets the same random streams, so the
// comparison is paired.
inline constexpr int kFinalists = 8;

struct FinalComparison {
  std::vector<double> mean_returns;  // (n) by final_rollouts, or by the screening ones alone
  int best = 0;                      // finalist of the highest mean return
  std::int64_t evaluations = 0;
};

// Rollouts that comparing n candidates takes.
std::int64_t FinalComparisonCost(int n_candidates, int final_rollouts);

// candidates: n x P row-major, n >= 1. A return that is not finite makes the candidate's mean
// -infinity. Throws Interrupted if `stop` (may be null) becomes true.
FinalComparison CompareFinalMeans(std::span<const double> candidates, int n_candidates,
                                  int final_rollouts, StreamKey key,
                                  const BatchObjective& objective, const std::atomic<bool>* stop);

}  // namespace downpour
