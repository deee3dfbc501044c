// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "engine/learner/learner.h"
#include "engine/learner/planned_model.h"

namespace downpour {

// Black-DROPS' part of an episode (paper Alg. 1): a policy by sampled rollouts of the model.

// Plans how rollouts query the model, by probes like what they meet. `record` is that of the
// episode, with the model's fields.
PlannedModel PlanQueries(const Task& task, const LearnerOptions& options, const LearnerState& state,
                         const Policy& policy, std::vector<ExactGp> gps,
                         const EpisodeRecord& record);

// Searches from the last policy, or from the origin, and fills the record's search fields but for
// search_seconds. Throws Interrupted.
void SearchByRollouts(const Task& task, const LearnerOptions& options, const LearnerState& state,
                      const Policy& policy, const Learner::Callbacks& callbacks,
                      PlannedModel* model, EpisodeRecord* record);

}  // namespace downpour
