// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/saved_policy.h"

#include <algorithm>
#include <array>
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
double PositiveNumber(const JsonField& field) {
  const double number = field.Number();
  if (!std::isfinite(number) || number <= 0) field.Fail("finite and > 0");
  return number;
}
std::vector<double> PositiveNumbers(const JsonField& field) {
  std::vector<double> numbers;
  for (const JsonField& item : field.Items()) numbers.push_back(PositiveNumber(item));
  return numbers;
}

constexpr std::array kFunctionNames = {"identity", "cosine", "sine"};  // FeatureKind

// The index of the field's string among `names`. Throws unless it is one of them.
template <std::size_t n>
int NameIndex(const JsonField& field, const std::array<const char*, n>& names) {
  const auto found = std::find(names.begin(), names.end(), field.String());
  if (found != names.end()) return static_cast<int>(found - names.begin());
  std::string allowed;
  for (const char* name : names)
    allowed += (allowed.empty() ? "one of " : ", ") + std::string(name);
  field.Fail(allowed);
}

bool Has(const JsonField& root, const char* key) { return root.value().contains(key); }

void ReadNetwork(const JsonField& root, SavedPolicy* policy) {
  const JsonField units = root["hidden_units"];
  if (units.value().is_number()) {
    policy->hidden_units = {units.Int(1, 256)};  // files of one hidden layer
  } else {
    for (const JsonField& item : units.Items()) policy->hidden_units.push_back(item.Int(1, 256));
  }
  if (!Has(root, "activation")) return;
  policy->activation = static_cast<Activation>(NameIndex(root["activation"], kActivationNames));
}

void ReadInputs(const JsonField& root, SavedPolicy* policy) {
  policy->states = root["states"].Strings();
  if (policy->states.empty()) root["states"].Fail("at least one name");
  for (const JsonField& item : root["feature_map"].Items()) {
    const int last = static_cast<int>(policy->states.size()) - 1;
    policy->feature_map.push_back(
        {static_cast<FeatureKind>(NameIndex(item["function"], kFunctionNames)),
         item["state"].Int(0, last)});
  }
  policy->control_period = PositiveNumber(root["control_period"]);
  policy->horizon = root["horizon"].Int(1, 1000000);
}

// Throws unless every array has one entry a feature or action.
void CheckSizes(const SavedPolicy& policy, const JsonField& root) {
  const auto check = [&](const char* key, std::size_t size, std::size_t wanted) {
    if (size != wanted) root[key].Fail("an array of " + std::to_string(wanted) + " entries");
  };
  if (!policy.states.empty()) {
    check("feature_map", policy.feature_map.size(), policy.features.size());
  }
  check("input_scale", policy.input_scale.size(), policy.features.size());
  check("action_limits", policy.action_limits.size(), policy.actions.size());
}

bool SameFeatures(const std::vector<Feature>& a, const std::vector<Feature>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const Feature& x, const Feature& y) {
    return x.kind == y.kind && x.state_index == y.state_index;
  });
}

std::vector<Variable> Variables(const std::vector<std::string>& names) {
  std::vector<Variable> variables;
  for (const std::string& name : names) variables.push_back({name, ""});
  return variables;
}

}  // namespace

SavedPolicy MakeSavedPolicy(const Task& task, const LearnerOptions& options, const Policy& policy,
                            const EpisodeRecord& record) {
  return {.kind = policy.kind(),
          .task = task.name,
          .preset = task.preset,
          .episode = record.episode,
          .hidden_units = options.policy.hidden_units,
          .activation = options.policy.activation,
          .points = options.policy.points == 0 ? task.policy_points : options.policy.points,
          .states = Names(task.states),
          .features = Names(task.feature_names),
          .feature_map = task.features,
          .input_scale = task.policy_input_scale,
          .actions = Names(task.actions),
          .action_limits = task.action_limits,
          .control_period = task.control_period,
          .horizon = task.horizon,
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
  if (policy.kind == "nn") {
    json["hidden_units"] = policy.hidden_units;
    json["activation"] = kActivationNames.at(static_cast<std::size_t>(policy.activation));
  }
  if (policy.kind == "gp" || policy.kind == "dmp") json["points"] = policy.points;
  json["states"] = policy.states;
  json["features"] = policy.features;
  for (const Feature& feature : policy.feature_map) {
    json["feature_map"].push_back(
        {{"function", kFunctionNames.at(static_cast<std::size_t>(feature.kind))},
         {"state", feature.state_index}});
  }
  json["input_scale"] = JsonNumbers(policy.input_scale);
  json["actions"] = policy.actions;
  json["action_limits"] = JsonNumbers(policy.action_limits);
  json["control_period"] = JsonNumber(policy.control_period);
  json["horizon"] = policy.horizon;
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
  policy.task = root["task"].String();
  policy.preset = root["preset"].String();
  policy.episode = root["episode"].Int(1, 1000);
  if (policy.kind == "nn") ReadNetwork(root, &policy);
  if (policy.kind == "gp" || policy.kind == "dmp") {
    policy.points = root["points"].Int(1, kMaxPolicyPoints);
  }
  if (policy.kind != "nn" || Has(root, "states")) ReadInputs(root, &policy);
  policy.features = root["features"].Strings();
  policy.input_scale = PositiveNumbers(root["input_scale"]);
  policy.actions = root["actions"].Strings();
  policy.action_limits = PositiveNumbers(root["action_limits"]);
  policy.predicted_return = root["predicted_return"].Number();
  policy.real_return = root["return"].Number();
  policy.solved = root["solved"].Bool();
  policy.parameters = FiniteNumbers(root["parameters"]);
  CheckSizes(policy, root);
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
  check(saved.states.empty() || saved.states == Names(task.states), "states");
  check(saved.states.empty() || SameFeatures(saved.feature_map, task.features), "feature_map");
  check(saved.kind != "dmp" || saved.horizon == task.horizon, "horizon");
  const auto kind = std::find(kPolicyKindNames.begin(), kPolicyKindNames.end(), saved.kind);
  if (kind == kPolicyKindNames.end()) {
    throw InvalidInput(origin + ": kind = \"" + saved.kind + "\": must be one of nn, linear, gp, " +
                       "dmp; another is a user's own and runs in the user's program");
  }
  PolicyOptions options;
  options.kind = static_cast<PolicyKind>(kind - kPolicyKindNames.begin());
  if (saved.kind == "nn") options.hidden_units = saved.hidden_units;
  options.activation = saved.activation;
  options.points = saved.points;
  std::unique_ptr<Policy> policy = MakePolicy(task, options);
  if (static_cast<int>(saved.parameters.size()) != policy->n_parameters()) {
    throw InvalidInput(origin + ": parameters has " + std::to_string(saved.parameters.size()) +
                       " entries: must be " + std::to_string(policy->n_parameters()));
  }
  return policy;
}

Task PolicyTask(const SavedPolicy& saved) {
  Task task;
  task.name = saved.task;
  task.preset = saved.preset;
  task.states = Variables(saved.states);
  task.features = saved.feature_map;
  task.feature_names = Variables(saved.features);
  task.actions = Variables(saved.actions);
  task.action_limits = saved.action_limits;
  task.policy_input_scale = saved.input_scale;
  task.control_period = saved.control_period;
  task.horizon = saved.horizon;
  return task;
}

}  // namespace downpour
