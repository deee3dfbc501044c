// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "engine/learner/learner.h"

namespace downpour {

// PILCO's part of an episode: the policy with the highest expected return by moment matching, found
// by its gradient from the last policy and from random starts (docs/pilco.md).

// Throws InvalidInput if `task` or `options` ask for what PILCO has no closed form of: a policy
// that is neither gp nor linear, a reward that is learnt or not saturating, a prior.
void CheckPilco(const Task& task, const LearnerOptions& options);

// Searches on `model` and fills the record's search fields but for search_seconds: evaluations are
// of value and gradient; there are neither queries nor plans. Throws Interrupted.
void SearchByMomentMatching(const Task& task, const LearnerOptions& options,
                            const LearnerState& state, const Learner::Callbacks& callbacks,
                            const std::vector<ExactGp>& model, EpisodeRecord* record);

}  // namespace downpour
