// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "engine/learner/learner.h"

namespace downpour {

// Throws InvalidInput that names the first option out of range, as a TOML key, its value and the
// allowed range. `search` is checked by CheckPolicySearchOptions (engine/search).
void CheckOptions(const LearnerOptions& options);

// Throws InvalidInput if the task's arrays disagree in size, a number is not finite or positive
// where it must be, or a function is missing.
void CheckTask(const Task& task);

// Throws InvalidInput if search.stop_lost_causes is on and rewards may leave [0, 1].
void CheckReward(const Task& task, const LearnerOptions& options);

// Throws InvalidInput that names the first field of `state` that cannot come from a run of `task`
// with `options`: sizes, numbering, numbers that are not finite. `n_parameters` of the policy.
void CheckState(const Task& task, const LearnerOptions& options, int n_parameters,
                const LearnerState& state);

}  // namespace downpour
