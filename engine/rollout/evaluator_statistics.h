// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "engine/rollout/rollout_parts.h"

namespace downpour {

// Counts of all calls of Evaluator::Evaluate so far, and of Evaluator::Count.
struct EvaluatorStatistics {
  std::int64_t rollouts = 0;
  std::int64_t steps = 0;       // rollouts x horizon, less those of lost causes
  std::int64_t gp_queries = 0;  // steps x E, x (E + 1) if the reward is learnt
  std::int64_t lane_steps = 0;  // computed, idle lanes in vectors included
  std::int64_t diverged = 0;    // rollouts that got the penalty
  // Wall time of the calls, and what of threads x seconds a thread spent without a tile; no result
  // depends on them.
  double seconds = 0, idle_seconds = 0;
  double prior_seconds = 0;  // of all threads together, spent in the prior's predictions
  PartTimes parts;           // after Evaluator::TimeParts

  // What has been added since `earlier`.
  EvaluatorStatistics Since(const EvaluatorStatistics& earlier) const {
    EvaluatorStatistics since = *this;
    since.rollouts -= earlier.rollouts;
    since.steps -= earlier.steps;
    since.gp_queries -= earlier.gp_queries;
    since.lane_steps -= earlier.lane_steps;
    since.diverged -= earlier.diverged;
    since.seconds -= earlier.seconds;
    since.idle_seconds -= earlier.idle_seconds;
    since.prior_seconds -= earlier.prior_seconds;
    since.parts -= earlier.parts;
    return since;
  }
  EvaluatorStatistics& operator+=(const EvaluatorStatistics& other) {
    rollouts += other.rollouts;
    steps += other.steps;
    gp_queries += other.gp_queries;
    lane_steps += other.lane_steps;
    diverged += other.diverged;
    seconds += other.seconds;
    idle_seconds += other.idle_seconds;
    prior_seconds += other.prior_seconds;
    parts += other.parts;
    return *this;
  }
  double LaneFill() const { return static_cast<double>(steps) / static_cast<double>(lane_steps); }
  double IdleShare(int threads) const { return idle_seconds / (threads * seconds); }
};

}  // namespace downpour
