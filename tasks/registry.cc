// SPDX-License-Identifier: Apache-2.0
#include "tasks/registry.h"

#include <algorithm>

#include "engine/errors.h"
#include "tasks/toml_task/toml_task.h"

// All tasks, one line each: tasks/<name>/<name>.cc defines downpour::<name>::Make().
#define DOWNPOUR_TASKS(TASK) \
  TASK(pendulum)             \
  TASK(cartpole)             \
  TASK(arm)

namespace downpour {

#define DOWNPOUR_DECLARE_TASK(name)                                   \
  namespace name {                                                    \
  Task Make(const std::string& preset, const std::string& mjcf_file); \
  }
DOWNPOUR_TASKS(DOWNPOUR_DECLARE_TASK)
#undef DOWNPOUR_DECLARE_TASK

namespace {

struct Entry {
  const char* name;
  Task (*make)(const std::string& preset, const std::string& mjcf_file);
};

#define DOWNPOUR_TASK_ENTRY(name) {#name, name::Make},
constexpr Entry kTasks[] = {DOWNPOUR_TASKS(DOWNPOUR_TASK_ENTRY)};
#undef DOWNPOUR_TASK_ENTRY

}  // namespace

std::vector<std::string> TaskNames() {
  std::vector<std::string> names;
  for (const Entry& entry : kTasks) names.push_back(entry.name);
  return names;
}

Task MakeTask(const std::string& name, const std::string& preset, const std::string& mjcf_file) {
  if (IsTaskFile(name)) {
    if (preset == "paper") return LoadTomlTask(name, mjcf_file);
    throw InvalidInput("preset = " + preset + ": must be left out: " + name + " has none");
  }
  const Entry* entry = std::find_if(std::begin(kTasks), std::end(kTasks),
                                    [&](const Entry& task) { return name == task.name; });
  if (entry == std::end(kTasks)) {
    std::string allowed;
    for (const Entry& task : kTasks)
      allowed += (allowed.empty() ? "" : ", ") + std::string(task.name);
    throw InvalidInput("task: unknown task '" + name + "'; allowed: " + allowed);
  }
  if (preset != "paper" && preset != "original-code") {
    throw InvalidInput("preset: unknown preset '" + preset + "' of task " + name +
                       "; allowed: paper, original-code");
  }
  return entry->make(preset, mjcf_file);
}

}  // namespace downpour
