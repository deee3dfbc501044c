// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "engine/rollout/task.h"

namespace downpour {

// Task::preset of every task from a file.
inline constexpr const char* kOwnPreset = "own";

// True if the name of a task is that of a file.
bool IsTaskFile(const std::string& name);

// The task that a TOML file describes (docs/tasks.md). Its name is the file's, without the folder
// and .toml; `mjcf_file` is used in place of the file's own model when not empty. Throws FileError
// if it cannot be read; InvalidInput with the file, the line, the key, its value and what is
// allowed. The model is loaded, so that all its names are checked.
Task LoadTomlTask(const std::string& file, const std::string& mjcf_file = "");

// The MJCF file that a task's file names, resolved from the file's folder. Throws as LoadTomlTask
// does, if the TOML or that key is wrong.
std::string TaskModelFile(const std::string& file);

}  // namespace downpour
