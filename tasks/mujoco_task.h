// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "engine/rollout/task.h"
#include "tasks/mujoco_system.h"

namespace downpour {

// Gives the task the simulator of `spec`, priors by other models of it, and the model's digest.
void SimulateByMujoco(const MujocoSystemSpec& spec, Task* task);

}  // namespace downpour
