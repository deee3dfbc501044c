// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/config.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <sstream>
#include <type_traits>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/suggest.h"
#include "tasks/registry.h"
#include "tasks/toml_task/toml_task.h"
#include "tools/downpour/config_toml.h"

namespace downpour {
namespace {

// "search.rollouts" -> "search"
std::string TableOf(const std::string& key) {
  return key.substr(0, std::min(key.find('.'), key.size()));
}

// What to tell a user who wrote an unknown key.
std::string SuggestKey(const std::vector<Field>& fields, const std::string& key) {
  std::vector<std::string> keys, of_table;
  for (const Field& field : fields) {
    if (field.key.ends_with('.' + key.substr(key.rfind('.') + 1))) {
      return fmt::format("did you mean {}?", field.key);  // the right name in no or another table
    }
    keys.push_back(field.key);
    if (key.starts_with(TableOf(field.key) + '.')) of_table.push_back(field.key);
  }
  if (of_table.empty() || IsSlip(key, ClosestName(key, keys))) return Suggest(key, keys);
  return fmt::format("the closest is {}", ClosestName(key, of_table));
}

// Throws InvalidInput if there is none.
const Field& FindField(const std::vector<Field>& fields, const std::string& origin,
                       const std::string& key) {
  const auto found = std::find_if(fields.begin(), fields.end(),
                                  [&](const Field& field) { return field.key == key; });
  if (found != fields.end()) return *found;
  throw InvalidInput(fmt::format("{}: unknown key {}; {}", origin, key, SuggestKey(fields, key)));
}

Setting FromNode(const std::string& origin, const std::string& key, const toml::node& node) {
  Setting setting{origin, key, {}, {}};
  std::ostringstream text;
  node.visit([&](const auto& n) { text << n; });
  setting.text = text.str();
  if (const auto* flag = node.as_boolean()) setting.value = flag->get();
  if (const auto* integer = node.as_integer()) setting.value = integer->get();
  if (const auto* number = node.as_floating_point()) setting.value = number->get();
  if (const auto* string = node.as_string()) setting.value = string->get();
  if (const auto* array = node.as_array();
      array != nullptr && array->is_homogeneous<std::int64_t>()) {
    std::vector<std::int64_t> list;
    for (const auto& item : *array) list.push_back(item.as_integer()->get());
    setting.value = list;
  }
  return setting;
}

// Throws InvalidInput unless some key is in the table.
void CheckTable(const std::vector<Field>& fields, const std::string& origin,
                const std::string& name) {
  std::vector<std::string> tables;
  for (const Field& field : fields) {
    if (field.key.starts_with(name + ".")) return;
    const std::string table = TableOf(field.key);
    if (table != field.key && (tables.empty() || tables.back() != table)) tables.push_back(table);
  }
  throw InvalidInput(fmt::format("{}: unknown table {}; {}", origin, name, Suggest(name, tables)));
}

// Writes the value of a setting into a member; false where the field does not accept it.
struct Assign {
  const Field& field;
  const Setting& setting;

  // NaN fails both comparisons.
  bool InRange(double x) const {
    return (field.above_min ? x > field.min : x >= field.min) && x <= field.max;
  }
  template <typename T>
  bool AssignInteger(T* target) const {
    std::int64_t value;
    if (const auto* integer = std::get_if<std::int64_t>(&setting.value)) {
      value = *integer;
    } else if (const auto* x = std::get_if<double>(&setting.value);
               x != nullptr && std::trunc(*x) == *x && std::abs(*x) <= 0x1p53) {
      value = static_cast<std::int64_t>(*x);  // 1e6 is an integer to a person
    } else {
      return false;
    }
    if (!InRange(static_cast<double>(value))) return false;
    *target = static_cast<T>(value);
    return true;
  }
  bool operator()(int* target) const { return AssignInteger(target); }
  bool operator()(std::int64_t* target) const { return AssignInteger(target); }
  bool operator()(std::uint64_t* target) const { return AssignInteger(target); }
  bool operator()(bool* target) const {
    const auto* value = std::get_if<bool>(&setting.value);
    if (value != nullptr) *target = *value;
    return value != nullptr;
  }
  bool operator()(double* target) const {
    double value = std::numeric_limits<double>::quiet_NaN();
    if (const auto* x = std::get_if<double>(&setting.value)) value = *x;
    if (const auto* integer = std::get_if<std::int64_t>(&setting.value)) {
      value = static_cast<double>(*integer);
    }
    if (!InRange(value)) return false;
    *target = value;
    return true;
  }
  bool operator()(std::string* target) const {
    const auto* value = std::get_if<std::string>(&setting.value);
    if (value == nullptr) return false;
    const bool is_file = !field.ending.empty() && value->ends_with(field.ending);
    if (!field.choices.empty() && !is_file && Choice(*value) < 0) return false;
    *target = *value;
    return true;
  }
  template <typename Enum>
  requires std::is_enum_v<Enum>
  bool operator()(Enum* target) const {
    const auto* value = std::get_if<std::string>(&setting.value);
    if (value == nullptr || Choice(*value) < 0) return false;
    *target = static_cast<Enum>(Choice(*value));
    return true;
  }
  // A single integer is a list of one.
  bool operator()(std::vector<int>* target) const {
    std::vector<std::int64_t> list;
    if (const auto* integer = std::get_if<std::int64_t>(&setting.value)) list = {*integer};
    if (const auto* given = std::get_if<std::vector<std::int64_t>>(&setting.value)) list = *given;
    const bool all = std::all_of(list.begin(), list.end(), [this](std::int64_t x) {
      return InRange(static_cast<double>(x));
    });
    if (list.empty() || !all) return false;
    target->assign(list.begin(), list.end());
    return true;
  }
  int Choice(const std::string& name) const {
    const auto found = std::find(field.choices.begin(), field.choices.end(), name);
    return found == field.choices.end() ? -1 : static_cast<int>(found - field.choices.begin());
  }
};

// A TOML value with all digits.
struct TomlText {
  const Field& field;
  std::string operator()(const bool* x) const { return *x ? "true" : "false"; }
  std::string operator()(const int* x) const { return std::to_string(*x); }
  std::string operator()(const std::int64_t* x) const { return std::to_string(*x); }
  std::string operator()(const std::uint64_t* x) const { return std::to_string(*x); }
  std::string operator()(const double* x) const {
    const std::string text = fmt::format("{}", *x);  // shortest text that reads back exactly
    return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
  }
  std::string operator()(const std::vector<int>* x) const { return fmt::format("{}", *x); }
  std::string operator()(const std::string* x) const {
    std::ostringstream text;
    text << toml::toml_formatter(toml::value<std::string>(*x), toml::format_flags::none);
    return text.str();
  }
  template <typename Enum>
  requires std::is_enum_v<Enum> std::string operator()(const Enum* x) const {
    return fmt::format("\"{}\"", field.choices[static_cast<std::size_t>(*x)]);
  }
};

std::string Trimmed(const std::string& text) {
  const std::size_t first = text.find_first_not_of(' ');
  if (first == std::string::npos) return "";
  return text.substr(first, text.find_last_not_of(' ') - first + 1);
}

// The task, a file by its full path.
std::string TaskName(const Setting& setting) {
  const std::string& name = std::get<std::string>(setting.value);
  if (!IsTaskFile(name)) return name;
  return std::filesystem::absolute(name).lexically_normal().string();
}

// The settings of one task do not suit another: a run's config.toml holds the task's own bounds.
// The settings must have been applied.
void CheckOneTask(const std::vector<Setting>& settings) {
  const Setting* first = nullptr;
  for (const Setting& setting : settings) {
    if (setting.key != "task") continue;
    if (first == nullptr) first = &setting;
    if (TaskName(setting) == TaskName(*first)) continue;
    throw InvalidInput(fmt::format("{}: task = {}: must be {}, as {} has it, or left out",
                                   setting.origin, std::get<std::string>(setting.value),
                                   std::get<std::string>(first->value), first->origin));
  }
}

// A setting that changes nothing would mislead. The settings must have been applied.
void CheckUsed(Algorithm algorithm, const std::vector<Setting>& settings) {
  for (const Setting& setting : settings) {
    if (UsesSetting(algorithm, setting.key)) continue;
    throw InvalidInput(
        fmt::format("{}: {} = {}: must be left out with learn.algorithm = {}, which "
                    "does not use it",
                    setting.origin, setting.key, setting.text,
                    kAlgorithmNames.at(static_cast<std::size_t>(algorithm))));
  }
}

}  // namespace

Setting FileSetting(const std::string& path, const std::string& key, const toml::node& node) {
  Setting setting = FromNode(fmt::format("{}:{}", path, node.source().begin.line), key, node);
  auto* const value = std::get_if<std::string>(&setting.value);
  if (key == "task" && value != nullptr && IsTaskFile(*value)) {
    const std::filesystem::path folder = std::filesystem::path(path).parent_path();
    *value = (folder / *value).lexically_normal().string();
  }
  return setting;
}

void AppendSettings(const std::vector<Field>& fields, const std::string& path,
                    const toml::table& table, std::vector<Setting>* settings,
                    const std::string& prefix) {
  for (const auto& [name, node] : table) {
    const std::string key = prefix + std::string(name.str());
    const std::string origin = fmt::format("{}:{}", path, node.source().begin.line);
    if (const toml::table* inner = node.as_table()) {
      CheckTable(fields, origin, key);
      AppendSettings(fields, path, *inner, settings, key + ".");
      continue;
    }
    FindField(fields, origin, key);
    settings->push_back(FileSetting(path, key, node));
  }
}

toml::table ParseTomlFile(const std::string& path) {
  const std::string text = ReadFile(path);
  try {
    return toml::parse(text, path);
  } catch (const toml::parse_error& error) {
    throw InvalidInput(fmt::format("{}:{}:{}: no valid TOML: {}", path, error.source().begin.line,
                                   error.source().begin.column, error.description()));
  }
}

std::vector<Setting> ReadConfigFile(const std::string& path) {
  std::vector<Setting> settings;
  RunConfig config;
  AppendSettings(ConfigFields(config), path, ParseTomlFile(path), &settings);
  return settings;
}

Setting ReadSetting(const std::string& origin, const Field& field, const std::string& text) {
  const bool is_number = field.max > field.min;
  const bool is_list = std::holds_alternative<std::vector<int>*>(field.target);
  if (is_number || std::holds_alternative<bool*>(field.target)) {
    try {
      // A list without brackets, as options have it.
      const bool bare = is_list && text.find('[') == std::string::npos;
      const toml::table table = toml::parse("value = " + (bare ? "[" + text + "]" : text));
      if (table.size() == 1) {
        Setting setting = FromNode(origin, field.key, *table.get("value"));
        setting.text = text;
        return setting;
      }
    } catch (const toml::parse_error&) {  // the check of the range names what is allowed
    }
  }
  return {origin, field.key, text, text};
}

Setting ParseAssignment(const std::string& origin, const std::string& text) {
  const std::size_t equals = text.find('=');
  const std::string key = Trimmed(text.substr(0, equals));
  if (equals == std::string::npos || key.empty()) {
    throw InvalidInput(
        fmt::format("{} {}: must be KEY=VALUE, e.g. search.rollouts=5", origin, text));
  }
  RunConfig config;
  const std::vector<Field> fields = ConfigFields(config);
  return ReadSetting(origin, FindField(fields, origin, key), Trimmed(text.substr(equals + 1)));
}

void RequireLibrarySetting(const Setting& setting) {
  if (!setting.key.starts_with("output.") && !setting.key.starts_with("system.")) return;
  throw InvalidInput(fmt::format("{}: {} is the command's alone", setting.origin, setting.key));
}

void ApplySettings(const std::vector<Field>& fields, const std::vector<Setting>& settings) {
  for (const Setting& setting : settings) {
    const Field& field = FindField(fields, setting.origin, setting.key);
    if (std::visit(Assign{field, setting}, field.target)) continue;
    std::string message = fmt::format("{}: {} = {}: must be {}", setting.origin, setting.key,
                                      setting.text, Allowed(field));
    const auto* name = std::get_if<std::string>(&setting.value);
    if (name != nullptr && !name->empty() && !field.choices.empty()) {
      const std::string closest = ClosestName(*name, field.choices);
      if (IsSlip(*name, closest)) message += fmt::format("; did you mean {}?", closest);
    }
    throw InvalidInput(message);
  }
}

ResolvedRun ResolveConfig(const std::vector<Setting>& settings) {
  RunConfig named;
  ApplySettings(ConfigFields(named), settings);
  CheckOneTask(settings);
  CheckUsed(named.learner.algorithm, settings);
  if (named.task.empty()) {
    throw InvalidInput(fmt::format("no task given: must be one of {}, or a file NAME.toml",
                                   fmt::join(TaskNames(), ", ")));
  }
  // The run must find the file again when it is resumed from another directory.
  for (std::string* file : {&named.mjcf, &named.prior.model}) {
    if (!file->empty()) *file = std::filesystem::absolute(*file).string();
  }
  // Not among the initialisers: GCC 12 destroys the others twice when one of them throws.
  Task task = MakeTask(named.task, named.preset, named.mjcf);
  ResolvedRun run{{}, std::move(task)};
  PolicySearchOptions& search = run.config.learner.search;
  search.bound = run.task.parameter_bound;
  search.first_sigma = run.task.search_first_sigma;
  search.restart_sigma = run.task.search_restart_sigma;
  search.restart_decades = run.task.search_restart_decades;
  run.config.learner.learn_reward = run.task.learn_reward;
  if (named.learner.algorithm == Algorithm::kPilco) {
    run.config.learner.policy.kind = PolicyKind::kGp;
  }
  ApplySettings(ConfigFields(run.config), settings);
  run.config.mjcf = named.mjcf;
  run.config.preset = run.task.preset;
  run.config.prior.model = named.prior.model;
  int& points = run.config.learner.policy.points;
  if (points == 0) points = run.task.policy_points;
  if (run.config.observation_std >= 0) {
    run.task.observation_std.assign(run.task.observation_std.size(), run.config.observation_std);
  }
  return run;
}

std::string ValueText(const Field& field) { return std::visit(TomlText{field}, field.target); }

std::string WriteConfig(const RunConfig& config) {
  RunConfig copy = config;
  std::string text = "# Every setting of this run. Repeat it: downpour learn --config THIS_FILE\n";
  std::string section;
  for (const Field& field : ConfigFields(copy)) {
    if (!field.saved) continue;
    const std::size_t dot = field.key.find('.');
    const std::string name = field.key.substr(dot == std::string::npos ? 0 : dot + 1);
    if (dot != std::string::npos && field.key.substr(0, dot) != section) {
      section = field.key.substr(0, dot);
      text += fmt::format("\n[{}]\n", section);
    }
    text += fmt::format("# {} {}\n{} = {}\n", field.description, "Must be " + Allowed(field) + ".",
                        name, ValueText(field));
  }
  return text;
}

}  // namespace downpour
