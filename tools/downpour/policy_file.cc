// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/policy_file.h"

#include <filesystem>

#include "tasks/registry.h"

namespace downpour {

LoadedPolicy LoadPolicy(const std::string& path) {
  std::filesystem::path file = path;
  if (std::filesystem::is_directory(file)) file /= "policy.json";
  SavedPolicy saved = ReadPolicy(file);
  Task task = saved.states.empty() ? MakeTask(saved.task, saved.preset) : PolicyTask(saved);
  return {std::move(saved), std::move(task)};
}

}  // namespace downpour
