// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "engine/rollout/task.h"
#include "tools/downpour/config.h"

namespace downpour {

// Gives the task the prior that `config.prior` names; does nothing if it names none. Throws
// InvalidInput as Task::make_prior does, if the task can have none, or if settings of a prior are
// given without a model.
void UsePrior(const RunConfig& config, Task* task);

}  // namespace downpour
