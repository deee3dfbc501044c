// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/study_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <set>
#include <tuple>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/learner.h"
#include "engine/learner/suggest.h"
#include "tools/downpour/config_toml.h"

namespace downpour {
namespace {

constexpr int kMostReplicates = 100000;

Field ReplicatesField(int* target) {
  return {.key = "replicates",
          .target = target,
          .min = 1,
          .max = kMostReplicates,
          .description = "Runs of every variant, seeds first_seed, first_seed + 1, ..."};
}

std::vector<Field> StudyFields(Study* study, int* replicates) {
  std::vector<Field> fields = JobFields(study);
  fields.push_back(ReplicatesField(replicates));
  fields.push_back({.key = "first_seed",
                    .target = &study->first_seed,
                    .min = 0,
                    .max = kMaxSeed - kMostReplicates,
                    .description = "Seed of the first replicate."});
  return fields;
}

// Why a study has no say in `key`; empty if it has.
std::string Elsewhere(const std::string& key) {
  if (key.starts_with("task")) return "tasks = [...] names them";
  if (key == "learn.seed") return "replicates and first_seed give the seeds";
  if (key.starts_with("output.")) return "runs lie beside the database";
  if (key.starts_with("system.")) return "a study is of simulators";
  return "";
}

// The settings of a run in one table, which may also have `replicates` if that is not null.
std::vector<Setting> RunSettings(const std::string& path, const toml::table& table,
                                 int* replicates = nullptr) {
  RunConfig config;
  std::vector<Field> fields = ConfigFields(config);
  if (replicates != nullptr) fields.push_back(ReplicatesField(replicates));
  std::vector<Setting> all, settings;
  AppendSettings(fields, path, table, &all);
  for (const Setting& setting : all) {
    const std::string reason = Elsewhere(setting.key);
    if (!reason.empty()) {
      throw InvalidInput(
          fmt::format("{}: {} is not to be set here: {}", setting.origin, setting.key, reason));
    }
    if (setting.key == "replicates") {
      ApplySettings(fields, {setting});
    } else {
      settings.push_back(setting);
    }
  }
  return settings;
}

// The keys of the top of the file, and its tables in the order of the file.
class StudyReader {
 public:
  explicit StudyReader(const std::string& path) : path_(path), file_(ParseTomlFile(path)) {}

  Study Read() {
    ReadTop();
    for (std::size_t i = 0; i < tasks_.size(); ++i) {
      for (const auto& [name, node] : InOrder(file_["variant"].as_table())) {
        study_.variants.push_back(Resolve(tasks_[i], task_names_[i], name, node));
      }
    }
    if (study_.variants.empty()) {
      throw InvalidInput(fmt::format(
          "{}: no variant: must have a table [variant.NAME] of settings for each", path_));
    }
    CheckTaskNames();
    return std::move(study_);
  }

 private:
  using Node = std::pair<std::string, const toml::node*>;

  std::string Origin(const toml::node& node) const {
    return fmt::format("{}:{}", path_, node.source().begin.line);
  }

  static std::vector<Node> InOrder(const toml::table* table) {
    std::vector<Node> nodes;
    if (table == nullptr) return nodes;
    for (const auto& [name, node] : *table) nodes.emplace_back(name.str(), &node);
    std::stable_sort(nodes.begin(), nodes.end(), [](const Node& a, const Node& b) {
      const auto& first = a.second->source().begin;
      const auto& second = b.second->source().begin;
      return std::tie(first.line, first.column) < std::tie(second.line, second.column);
    });
    return nodes;
  }

  void ReadTop() {
    const std::vector<Field> fields = StudyFields(&study_, &replicates_);
    std::vector<std::string> allowed = {"tasks", "settings", "task", "variant"};
    for (const Field& field : fields) allowed.push_back(field.key);
    std::vector<Setting> settings;
    for (const auto& [name, node] : InOrder(&file_)) {
      const auto position = std::find(allowed.begin(), allowed.end(), name) - allowed.begin();
      if (position == static_cast<std::ptrdiff_t>(allowed.size())) {
        throw InvalidInput(fmt::format("{}: unknown key {}; {}{}", Origin(*node), name,
                                       Suggest(name, allowed), RunSettingHint(name)));
      }
      if (position >= 4) {
        settings.push_back(FileSetting(path_, name, *node));
      } else if (position >= 1 && !node->is_table()) {
        throw InvalidInput(fmt::format("{}: {}: must be a table, [{}{}]", Origin(*node), name, name,
                                       position == 1 ? "" : ".NAME"));
      }
    }
    ApplySettings(fields, settings);
    ReadTasks();
    if (const toml::table* common = file_["settings"].as_table()) {
      common_ = RunSettings(path_, *common);
    }
    ReadTaskTables();
  }

  // A setting of runs that stands at the top.
  static std::string RunSettingHint(const std::string& name) {
    RunConfig config;
    for (const Field& field : ConfigFields(config)) {
      if (field.key == name || field.key.starts_with(name + ".")) {
        return "; settings of all runs stand in [settings]";
      }
    }
    return "";
  }

  void ReadTasks() {
    const toml::node* tasks = file_.get("tasks");
    const toml::array* list = tasks == nullptr ? nullptr : tasks->as_array();
    if (list == nullptr || list->empty() || !list->is_homogeneous<std::string>()) {
      const std::string where =
          tasks == nullptr ? path_ + ": tasks is missing" : Origin(*tasks) + ": tasks";
      throw InvalidInput(where + ": must be a list of tasks, e.g. [\"pendulum\"]");
    }
    for (const toml::node& node : *list) {
      task_names_.push_back(node.as_string()->get());
      tasks_.push_back(FileSetting(path_, "task", node));
    }
  }

  void ReadTaskTables() {
    for (const auto& [name, node] : InOrder(file_["task"].as_table())) {
      if (std::find(task_names_.begin(), task_names_.end(), name) == task_names_.end()) {
        throw InvalidInput(fmt::format("{}: [task.{}]: not among the tasks; {}", Origin(*node),
                                       name, Suggest(name, task_names_)));
      }
      if (!node->is_table()) {
        throw InvalidInput(
            fmt::format("{}: task.{}: must be a table of settings", Origin(*node), name));
      }
      task_replicates_[name] = replicates_;
      task_settings_[name] = RunSettings(path_, *node->as_table(), &task_replicates_[name]);
    }
  }

  StudyVariant Resolve(const Setting& task, const std::string& key, const std::string& name,
                       const toml::node* node) {
    constexpr const char* kPlain = " ._-+()";
    const bool plain = std::all_of(name.begin(), name.end(), [](unsigned char c) {
      return c < 128 && (std::isalnum(c) != 0 || std::string(kPlain).find(c) != std::string::npos);
    });
    if (!plain || name.size() > 60 || name.empty() || name.find_first_of(" .-") == 0) {
      throw InvalidInput(
          fmt::format("{}: variant \"{}\": a name must begin with a letter, a digit or one of "
                      "_+() and have at most 60 letters, digits, spaces and ._-+()",
                      Origin(*node), name));
    }
    if (!node->is_table()) {
      throw InvalidInput(
          fmt::format("{}: variant.{}: must be a table of settings", Origin(*node), name));
    }
    StudyVariant variant{.name = name, .origin = Origin(*node), .settings = {task}};
    const auto own = task_replicates_.find(key);
    variant.replicates = own == task_replicates_.end() ? replicates_ : own->second;
    for (const std::vector<Setting>& part :
         {common_, task_settings_[key], RunSettings(path_, *node->as_table())}) {
      variant.settings.insert(variant.settings.end(), part.begin(), part.end());
    }
    ResolvedRun run = ResolveConfig(variant.settings);
    try {
      const Learner checked(run.task, run.config.learner);
    } catch (const InvalidInput& error) {
      throw InvalidInput(fmt::format("{}: {} on {}: {}", variant.origin, name, key, error.what()));
    }
    variant.task = run.task.name;
    variant.config = run.config;
    variant.control_period = run.task.control_period;
    variant.horizon = run.task.horizon;
    return variant;
  }

  void CheckTaskNames() const {
    std::set<std::pair<std::string, std::string>> seen;
    for (const StudyVariant& variant : study_.variants) {
      if (seen.emplace(variant.task, variant.name).second) continue;
      throw InvalidInput(fmt::format("{}: tasks: {} is there twice; must be there once",
                                     tasks_.front().origin, variant.task));
    }
  }

  std::string path_;
  toml::table file_;
  Study study_;
  int replicates_ = 10;
  std::vector<Setting> tasks_;
  std::vector<std::string> task_names_;  // as written
  std::vector<Setting> common_;
  std::map<std::string, int> task_replicates_;
  std::map<std::string, std::vector<Setting>> task_settings_;
};

}  // namespace

std::vector<Field> JobFields(Study* study) {
  return {{.key = "jobs",
           .option = "--jobs",
           .target = &study->jobs,
           .min = 0,
           .max = 1024,
           .description = "Runs side by side; 0: one a core."},
          {.key = "threads",
           .option = "--threads",
           .target = &study->threads,
           .min = 0,
           .max = 1024,
           .description = "Threads of a run; 0: the cores shared out among the jobs."}};
}

Study ReadStudyFile(const std::string& path) { return StudyReader(path).Read(); }

std::map<std::string, std::string> ResultSettings(const RunConfig& config) {
  RunConfig copy = config;
  std::map<std::string, std::string> settings;
  for (const Field& field : ConfigFields(copy)) {
    const bool same_results = field.key == "learn.threads" || field.key == "learn.episodes";
    if (!field.saved || same_results || !Elsewhere(field.key).empty()) continue;
    settings[field.key] = ValueText(field);
  }
  return settings;
}

std::string Assignment(const Setting& setting) {
  const auto* text = std::get_if<std::string>(&setting.value);
  return fmt::format("{}={}", setting.key, text == nullptr ? setting.text : *text);
}

}  // namespace downpour
