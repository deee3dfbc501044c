// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/saved_policy.h"

#include <cmath>
#include <nlohmann/json.hpp>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/json_field.h"

namespace downpour {
namespace {

std::vector<std::string> Names(const std::vector<Variable>& variables) {
  std::vector<std::string> names;
  for (const Variable& variable : variables) names.push_back(variable.name);
  return names;
}

// The numbers of an array. Throws unless each is finite.
std::vector<double> FiniteNumbers(const JsonField& field) {
  for (const JsonField& item : field.Items()) {
    if (!std::isfinite(item.Number())) item.Fail("finite");
  }
  return field.Numbers();
}

// The same for numbers that must be > 0, too.
std::vector<double> PositiveNumbers(const JsonField& field) {
  for (const JsonField& item : field.Items()) {
    if (!std::isfinite(item.Number()) || item.Number() <= 0) item.Fail("finite and > 0");
  }
  return field.Numbers();
}

}  // namespace

SavedPolicy MakeSavedPolicy(const Task& task, const LearnerOptions& options, const Policy& policy,
                            const EpisodeRecord& record) {
  return {.kind = policy.kind(),
          .task = task.name,
          .preset = task.preset,
          .episode = record.episode,
          .hidden_units = options.hidden_units,
          .features = Names(task.feature_names),
          .input_scale = task.policy_input_scale,
          .actions = Names(task.actions),
          .action_limits = task.action_limits,
          .parameters = record.policy,
          .predicted_return = record.predicted_return,
          .real_return = record.real_return,
          .solved = record.solved};
}

std::string FormatPolicy(const SavedPolicy& policy) {
  nlohmann::ordered_json json;
  json["kind"] = policy.kind;
  json["task"] = policy.task;
  json["preset"] = policy.preset;
  json["episode"] = policy.episode;
  json["hidden_units"] = policy.hidden_units;
  json["features"] = policy.features;
  json["input_scale"] = JsonNumbers(policy.input_scale);
  json["actions"] = policy.actions;
  json["action_limits"] = JsonNumbers(policy.action_limits);
  json["predicted_return"] = JsonNumber(policy.predicted_return);
  json["return"] = JsonNumber(policy.real_return);
  json["solved"] = policy.solved;
  json["parameters"] = JsonNumbers(policy.parameters);
  return json.dump(1) + "\n";
}

SavedPolicy ReadPolicy(const std::filesystem::path& path) {
  const std::string file = path.string();
  const nlohmann::json json = ParseJson(ReadFile(path), file);
  const JsonField root(json, file);
  SavedPolicy policy;
  policy.file = file;
  policy.kind = root["kind"].String();
  if (policy.kind != "nn") root["kind"].Fail("\"nn\"");
  policy.task = root["task"].String();
  policy.preset = root["preset"].String();
  policy.episode = root["episode"].Int(1, 1000);
  policy.hidden_units = root["hidden_units"].Int(1, 256);
  policy.features = root["features"].Strings();
  policy.input_scale = PositiveNumbers(root["input_scale"]);
  policy.actions = root["actions"].Strings();
  policy.action_limits = PositiveNumbers(root["action_limits"]);
  policy.predicted_return = root["predicted_return"].Number();
  policy.real_return = root["return"].Number();
  policy.solved = root["solved"].Bool();
  policy.parameters = FiniteNumbers(root["parameters"]);
  return policy;
}

std::unique_ptr<Policy> MakePolicy(const SavedPolicy& saved, const Task& task) {
  const std::string origin =
      saved.file + (saved.file.empty() ? "" : ": ") + "policy of task " + saved.task;
  const auto check = [&](bool fits, const char* field) {
    if (fits) return;
    throw InvalidInput(origin + ", preset " + saved.preset + ": " + field +
                       " differ from those of task " + task.name + ", preset " + task.preset);
  };
  check(saved.task == task.name && saved.preset == task.preset, "task and preset");
  check(saved.features == Names(task.feature_names), "features");
  check(saved.input_scale == task.policy_input_scale, "input_scale");
  check(saved.actions == Names(task.actions), "actions");
  check(saved.action_limits == task.action_limits, "action_limits");
  std::unique_ptr<Policy> policy = MakeNeuralNetworkPolicy(task, saved.hidden_units);
  if (static_cast<int>(saved.parameters.size()) != policy->n_parameters()) {
    throw InvalidInput(origin + ": parameters has " + std::to_string(saved.parameters.size()) +
                       " entries: must be " + std::to_string(policy->n_parameters()));
  }
  return policy;
}

}  // namespace downpour
