// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>
#include <string>
#include <vector>

#include "engine/rollout/reward.h"
#include "tasks/registry.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"

namespace downpour {
namespace {

std::string Names(const std::vector<Variable>& variables) {
  std::vector<std::string> parts;
  for (const Variable& v : variables) {
    parts.push_back(v.unit.empty() ? v.name : fmt::format("{} [{}]", v.name, v.unit));
  }
  return fmt::format("{}", fmt::join(parts, ", "));
}

std::string Limits(const Task& task) {
  std::vector<std::string> parts;
  for (int i = 0; i < task.n_actions(); ++i) {
    parts.push_back(fmt::format("{} [{}] within +-{}", task.actions[i].name, task.actions[i].unit,
                                task.action_limits[i]));
  }
  return fmt::format("{}", fmt::join(parts, ", "));
}

void Print(const Task& task) {
  fmt::print("{}: {}\n", task.name, task.description);
  const auto row = [](const char* name, const std::string& text) {
    fmt::print("  {:<9} {}\n", name, text);
  };
  row("states", Names(task.states));
  row("features", Names(task.feature_names));
  row("actions", Limits(task));
  row("start", fmt::format("mean ({}), std ({})", fmt::join(task.start_mean, ", "),
                           fmt::join(task.start_std, ", ")));
  row("noise", fmt::format("observation std ({})", fmt::join(task.observation_std, ", ")));
  row("reward",
      fmt::format(
          "{}{}", task.reward->Describe(),
          task.learn_reward ? "; unknown to the learner unless learn.learn_reward = false" : ""));
  row("solved", task.solved_description);
  row("episode",
      fmt::format(
          "{} steps of {} s{}", task.horizon, task.control_period,
          task.reward->InUnitInterval() ? fmt::format(", return at most {}", task.horizon) : ""));
}

}  // namespace

void AddTasksCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand("tasks", "List the tasks with their units");
  auto preset = std::make_shared<std::string>();
  auto task = std::make_shared<std::string>();
  command->add_option("TASK", *task, "Show this one alone, or that of FILE.toml")
      ->check(NotEmpty());
  command->add_option("--preset", *preset, "paper or original-code; default: each task's own");
  command->callback([preset, task] {
    if (!task->empty()) return Print(MakeTask(*task, *preset));
    bool first = true;
    for (const std::string& name : TaskNames()) {
      if (!first) fmt::print("\n");
      first = false;
      Print(MakeTask(name, *preset));
    }
  });
}

}  // namespace downpour
