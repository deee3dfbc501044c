// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "engine/rollout/task.h"
#include "tools/downpour/config.h"

namespace downpour {

// Puts the robot that `config.system` names in the place of the task's simulator, whose model is
// then none of the task's; does nothing if it names none. Where it does, installs the stop handler
// (stop.h), so that a robot is told to stop before the process ends. Throws InvalidInput if the
// command is none, or if the configuration has settings of the simulator, too.
void UseRobot(const RunConfig& config, Task* task);

}  // namespace downpour
