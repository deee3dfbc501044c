// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "tasks/registry.h"
#include "tools/downpour/commands.h"

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

// Row `row` of A f - b, e.g. "cos_angle + 1".
std::string Residual(const Task& task, int row) {
  std::string text;
  const auto append = [&](double factor, const std::string& name) {
    if (factor == 0) return;
    text += text.empty() ? (factor < 0 ? "-" : "") : (factor < 0 ? " - " : " + ");
    const double size = std::abs(factor);
    if (name.empty()) {
      text += fmt::format("{:.6g}", size);
    } else {
      text += size == 1 ? name : fmt::format("{:.6g} {}", size, name);
    }
  };
  for (int i = 0; i < task.n_features(); ++i) {
    append(task.reward.a[row * task.n_features() + i], task.feature_names[i].name);
  }
  append(-task.reward.b[row], "");
  return text;
}

std::string Reward(const Task& task) {
  std::vector<std::string> squares;
  for (int row = 0; row < task.reward.n_rows; ++row) {
    squares.push_back(fmt::format("({})^2", Residual(task, row)));
  }
  return fmt::format("exp(-d^2 / (2 x {}^2)), d^2 = {}", task.reward.width,
                     fmt::join(squares, " + "));
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
  row("reward", Reward(task));
  row("solved", task.solved_description);
  row("episode", fmt::format("{} steps of {} s, return at most {}", task.horizon,
                             task.control_period, task.horizon));
}

}  // namespace

void AddTasksCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand("tasks", "List the tasks with their units");
  auto preset = std::make_shared<std::string>("paper");
  command->add_option("--preset", *preset, "paper or original-code")->capture_default_str();
  command->callback([preset] {
    bool first = true;
    for (const std::string& name : TaskNames()) {
      if (!first) fmt::print("\n");
      first = false;
      Print(MakeTask(name, *preset));
    }
  });
}

}  // namespace downpour
