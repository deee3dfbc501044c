// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/rollout/evaluator.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/policy_file.h"

namespace downpour {
namespace {

// The numbers of a line, a JSON array or separated by spaces or commas; false if there is anything
// else in it.
bool ReadNumbers(std::string line, std::vector<double>* numbers) {
  numbers->clear();
  if (line.find('[') != std::string::npos) {
    const nlohmann::json json = nlohmann::json::parse(line, nullptr, false);
    if (!json.is_array()) return false;
    for (const nlohmann::json& item : json) {
      if (!item.is_number()) return false;
      numbers->push_back(item.get<double>());
    }
    return true;
  }
  std::replace(line.begin(), line.end(), ',', ' ');
  std::istringstream words(line);
  for (std::string word; words >> word;) {
    char* end = nullptr;
    numbers->push_back(std::strtod(word.c_str(), &end));
    if (*end != '\0') return false;
  }
  return true;
}

// The state in line `number` of standard input.
std::vector<double> ReadState(const Task& task, const std::string& line, int number) {
  std::vector<double> state;
  const bool valid = ReadNumbers(line, &state) && state.size() == task.states.size() &&
                     std::all_of(state.begin(), state.end(), [](double x) {  // false for NaN, too
                       return std::abs(x) <= Evaluator::kStateLimit;
                     });
  if (valid) return state;
  std::string found = line.substr(0, 60);
  for (char& c : found) c = c >= ' ' && c <= '~' ? c : '?';
  std::vector<std::string> names;
  for (const Variable& variable : task.states) names.push_back(variable.name);
  throw InvalidInput(fmt::format(
      "standard input:{}: \"{}\": must be {} number{} in [-{}, {}] ({}), separated by spaces or "
      "commas, or a JSON array of them",
      number, found, names.size(), names.size() == 1 ? "" : "s", Evaluator::kStateLimit,
      Evaluator::kStateLimit, fmt::join(names, ", ")));
}

void Act(const std::string& path) {
  const LoadedPolicy loaded = LoadPolicy(path);
  const Task& task = loaded.task;
  const std::unique_ptr<Policy> policy = MakePolicy(loaded.saved, task);
  std::vector<double> features(task.features.size()), action(task.actions.size());
  int number = 0;
  for (std::string line; std::getline(std::cin, line); ++number) {
    const std::vector<double> state = ReadState(task, line, number + 1);
    ComputeFeatures(task, state, features);
    policy->Act(number, loaded.saved.parameters, features, action);
    fmt::print("{}\n", fmt::join(action, " "));
    // At once: the robot waits for it.
    if (std::fflush(stdout) != 0) throw FileError("standard output: cannot write");
  }
}

}  // namespace

void AddActCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand(
      "act", "Read states from standard input, one a line, and write the policy's actions");
  auto path = std::make_shared<std::string>();
  command->add_option("POLICY", *path, "policy.json, or a run directory for its last")
      ->required()
      ->check(NotEmpty());
  command->footer(
      "A line holds the state's numbers, separated by spaces or commas, or a JSON array of them;\n"
      "the answer is one line, the action's numbers separated by spaces. A line that is no state\n"
      "ends the command with exit code 2 and a message: no action is ever repeated or made up.\n"
      "The first line is step 0, which dmp policies go by.");
  command->callback([path] { Act(*path); });
}

}  // namespace downpour
