// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "engine/rollout/task.h"

namespace downpour {

// Names of all tasks, in the order of the registry.
std::vector<std::string> TaskNames();

// A task by name, or from a file whose name ends in .toml (toml_task.h). `preset` is "paper" or
// "original-code", or "" for the task's own, "original-code" of the arm and else "paper"; of a file
// "" alone. `mjcf_file` replaces the task's own MJCF when not empty (same joints and actuators).
// Throws InvalidInput that names what is allowed.
Task MakeTask(const std::string& name, const std::string& preset = "",
              const std::string& mjcf_file = "");

}  // namespace downpour
