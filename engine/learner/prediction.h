// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "engine/learner/learner.h"

namespace downpour {

// What the model expects of a learnt policy.
struct Prediction {
  Trajectories trajectories;    // of R rollouts
  std::vector<double> returns;  // (R) sums of rewards; NaN for a rollout that diverged
  double mean_return = 0;       // of those that did not; NaN if all did
  double return_std = 0;        // of the returns of rollouts, not of their mean
  int n_diverged = 0;
};

// Rollouts of a learnt episode's policy, `policy` with the record's parameters, on the exact fp64
// model that it was searched on (the search itself may have queried a plan of that model). Start
// states and samples are of the episode's own stream: rollout r is the same however many there are.
Prediction PredictEpisode(const Task& task, const LearnerOptions& options, const Policy& policy,
                          const std::vector<Transition>& transitions, const EpisodeRecord& record,
                          int n_rollouts);

// A row a rollout and step, to where the rollout diverged, as transitions.csv: rollout, step, time,
// state (E), action (A), next state (E), reward.
std::string PredictionCsv(const Task& task, const Prediction& prediction);

}  // namespace downpour
