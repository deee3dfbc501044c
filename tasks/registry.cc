// SPDX-License-Identifier: Apache-2.0
#include "tasks/registry.h"

#include <algorithm>

#include "engine/errors.h"
#include "tasks/toml_task/toml_task.h"

// All tasks, one line each: tasks/<name>/<name>.cc defines downpour::<name>::Make(); and the preset
// that is meant when none is named. Of the paper's reward of the arm nothing can be learnt while it
// is unknown (docs/results.md).
#define DOWNPOUR_TASKS(TASK) \
  TASK(pendulum, "paper")    \
  TASK(cartpole, "paper")    \
  TASK(arm, "original-code")

namespace downpour {

#define DOWNPOUR_DECLARE_TASK(name, own_preset)                       \
  namespace name {                                                    \
  Task Make(const std::string& preset, const std::string& mjcf_file); \
  }
DOWNPOUR_TASKS(DOWNPOUR_DECLARE_TASK)
#undef DOWNPOUR_DECLARE_TASK

namespace {

struct Entry {
  const char* name;
  const char* preset;
  Task (*make)(const std::string& preset, const std::string& mjcf_file);
};

#define DOWNPOUR_TASK_ENTRY(name, own_preset) {#name, own_preset, name::Make},
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
    if (preset.empty()) return LoadTomlTask(name, mjcf_file);
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
  const std::string chosen = preset.empty() ? entry->preset : preset;
  if (chosen != "paper" && chosen != "original-code") {
    throw InvalidInput("preset: unknown preset '" + preset + "' of task " + name +
                       "; allowed: paper, original-code");
  }
  return entry->make(chosen, mjcf_file);
}

}  // namespace downpour
