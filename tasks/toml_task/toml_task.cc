// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/toml_task.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/checksum.h"
#include "engine/learner/suggest.h"
#include "engine/rollout/reward.h"
#include "tasks/mujoco_system.h"
#include "tasks/mujoco_task.h"
#include "tasks/toml_task/task_formula.h"
#include "tasks/toml_task/toml_table.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

constexpr const char* kEnding = ".toml";
constexpr NumberRange kAny = {-1e6, 1e6}, kNotNegative = {0, 1e6}, kPositive = {0, 1e6, true};

// What is being read: the task so far, and what its parts need of each other.
struct Reading {
  std::unique_ptr<mjModel, void (*)(mjModel*)> model{nullptr, nullptr};
  MujocoSystemSpec spec;
  Task task;
  std::vector<int> state_of_joint;  // of the model's joints: the state that is its position, or -1
};

toml::table Parse(const std::string& file) {
  const std::string text = ReadFile(file);
  try {
    return toml::parse(text, file);
  } catch (const toml::parse_error& error) {
    throw InvalidInput(file + ":" + std::to_string(error.source().begin.line) + ":" +
                       std::to_string(error.source().begin.column) +
                       ": no valid TOML: " + std::string(error.description()));
  }
}

std::string ModelFile(TomlTable* root, const std::string& file) {
  const fs::path path = root->Text("mjcf");
  if (path.is_absolute()) root->Fail("mjcf", "must be a path from this file's folder");
  return (fs::path(file).parent_path() / path).lexically_normal().string();
}

// The model's object of that kind named by `key`. Throws if it has none.
int FindObject(TomlTable* table, const std::string& key, const mjModel& model, mjtObj type,
               int count) {
  const std::string name = table->Text(key);
  const int id = mj_name2id(&model, type, name.c_str());
  if (id >= 0) return id;
  std::vector<std::string> names;
  for (int i = 0; i < count; ++i) {
    const char* const each = mj_id2name(&model, type, i);
    if (each != nullptr && *each != '\0') names.push_back(each);
  }
  const std::string kind = key == "actuator" || key == "sensor" ? "named " + key : key;
  table->Fail(key, "the model has no such " + key +
                       (names.empty() ? ", nor any other " + kind : "; " + Suggest(name, names)));
}

// A name that formulas and files can hold, and that is no other's.
std::string NewName(TomlTable* table, const std::vector<std::string>& others) {
  const std::string name = table->Text("name");
  if (!IsFormulaName(name)) {
    table->Fail("name", "must be letters, digits and _, a letter first, and no function's name");
  }
  if (std::find(others.begin(), others.end(), name) != others.end()) {
    table->Fail("name", "must differ from the other names of states, features and actions");
  }
  return name;
}

std::vector<std::string> NamesSoFar(const Task& task) {
  std::vector<std::string> names;
  for (const Variable& each : task.states) names.push_back(each.name);
  for (const Variable& each : task.feature_names) names.push_back(each.name);
  for (const Variable& each : task.actions) names.push_back(each.name);
  return names;
}

// Where the state comes from; true if it is a joint's.
bool ReadSource(TomlTable* table, Reading* reading) {
  const mjModel& model = *reading->model;
  JointState source{0, JointQuantity::kPosition};
  const int given = table->Has("joint") + table->Has("sensor") + table->Has("site");
  if (given != 1) table->FailHere("must have one of joint, sensor and site");
  if (table->Has("joint")) {
    const int joint = FindObject(table, "joint", model, mjOBJ_JOINT, model.njnt);
    if (model.jnt_type[joint] != mjJNT_HINGE && model.jnt_type[joint] != mjJNT_SLIDE) {
      table->Fail("joint", "must be a hinge or a slide");
    }
    const std::string quantity = table->Text("quantity");
    if (quantity != "position" && quantity != "velocity") {
      table->Fail("quantity", "must be position or velocity");
    }
    if (quantity == "velocity") source.quantity = JointQuantity::kVelocity;
    const std::string name = mj_id2name(&model, mjOBJ_JOINT, joint);
    std::vector<std::string>& joints = reading->spec.joints;
    const auto found = std::find(joints.begin(), joints.end(), name);
    source.joint = static_cast<int>(found - joints.begin());
    if (found == joints.end()) joints.push_back(name);
    for (const JointState& other : reading->spec.states) {
      if (other.sensor.empty() && other.site.empty() && other.joint == source.joint &&
          other.quantity == source.quantity) {
        table->Fail("joint", "its " + quantity + " must be one state, not two");
      }
    }
    if (quantity == "position") reading->state_of_joint[joint] = reading->task.n_states();
  } else if (table->Has("sensor")) {
    const int sensor = FindObject(table, "sensor", model, mjOBJ_SENSOR, model.nsensor);
    source.sensor = mj_id2name(&model, mjOBJ_SENSOR, sensor);
    const double last = model.sensor_dim[sensor] - 1;
    source.component = table->Integer("component", {0, last}, 0);
  } else {
    const int site = FindObject(table, "site", model, mjOBJ_SITE, model.nsite);
    source.site = mj_id2name(&model, mjOBJ_SITE, site);
    const std::string axis = table->Text("axis");
    source.component = static_cast<int>(std::string("xyz").find(axis));
    if (axis.size() != 1 || source.component < 0) table->Fail("axis", "must be x, y or z");
  }
  reading->spec.states.push_back(source);
  return source.sensor.empty() && source.site.empty();
}

void ReadState(TomlTable table, Reading* reading) {
  Task& task = reading->task;
  const std::string name = NewName(&table, NamesSoFar(task));
  const std::string unit = table.Text("unit");
  const bool of_joint = ReadSource(&table, reading);
  const int index = task.n_states();
  if (table.Flag("angle", false)) {
    const std::vector<std::string> taken = NamesSoFar(task);
    for (const char* function : {"cos_", "sin_"}) {
      if (std::find(taken.begin(), taken.end(), function + name) == taken.end()) continue;
      table.Fail("name", "as an angle it has features cos_" + name + " and sin_" + name +
                             ", which must be no other's names");
    }
    task.features.push_back({FeatureKind::kCosine, index});
    task.features.push_back({FeatureKind::kSine, index});
    task.feature_names.push_back({"cos_" + name, "1"});
    task.feature_names.push_back({"sin_" + name, "1"});
  } else {
    task.features.push_back({FeatureKind::kIdentity, index});
    task.feature_names.push_back({name, unit});
  }
  task.states.push_back({name, unit});
  // What follows from the joints is computed once all of them are known.
  task.start_mean.push_back(of_joint ? table.Number("start_mean", kAny, 0) : 0);
  task.start_std.push_back(table.Number("start_std", kNotNegative, 0));
  task.observation_std.push_back(table.Number("observation_std", kNotNegative, 0));
  task.policy_input_scale.resize(task.features.size(), table.Number("policy_scale", kPositive, 1));
  table.CheckNoOthers();
}

void ReadAction(TomlTable table, Reading* reading) {
  const mjModel& model = *reading->model;
  Task& task = reading->task;
  const std::string name = NewName(&table, NamesSoFar(task));
  const int actuator = FindObject(&table, "actuator", model, mjOBJ_ACTUATOR, model.nu);
  const std::string actuator_name = mj_id2name(&model, mjOBJ_ACTUATOR, actuator);
  std::vector<std::string>& actuators = reading->spec.actuators;
  if (std::find(actuators.begin(), actuators.end(), actuator_name) != actuators.end()) {
    table.Fail("actuator", "must be of one action, not two");
  }
  actuators.push_back(actuator_name);
  task.actions.push_back({name, table.Text("unit")});
  task.action_limits.push_back(table.Number("limit", kPositive));
  table.CheckNoOthers();
}

// Residuals are sums of features and a constant: the rows of A f - b.
std::shared_ptr<const Reward> ReadResiduals(TomlTable* table, const Reading& reading) {
  std::vector<std::string> names;
  for (const Variable& feature : reading.task.feature_names) names.push_back(feature.name);
  std::vector<double> a, b;
  for (TomlTable& residual : table->Tables("residuals")) {
    const std::vector<double> row = residual.NumbersOf(names);
    a.insert(a.end(), row.begin(), row.end());
    const double constant = residual.Number("constant", kAny, 0);
    b.push_back(constant == 0 ? 0 : -constant);
    residual.CheckNoOthers();
  }
  return MakeSaturatingReward(reading.task.feature_names, a, b, table->Number("width", kPositive));
}

std::shared_ptr<const Reward> ReadDistance(TomlTable* table, const Reading& reading) {
  const std::vector<std::string> sites = table->Texts("distance", 2);
  const double width = table->Number("width", kPositive);
  const int power = table->Integer("power", {1, 2}, 2);
  try {
    return MakeSiteDistanceReward(SitePositions(*reading.model, reading.state_of_joint, sites),
                                  sites[0], sites[1], power, width);
  } catch (const InvalidInput& error) {
    table->Fail("distance", error.what());
  }
}

// Formulas may take several lines in the file, but take one where they are described.
std::string OnOneLine(const std::string& text) {
  std::string line;
  for (const char c : text) {
    const bool is_space = c == ' ' || c == '\t' || c == '\r' || c == '\n';
    if (!is_space) line += c;
    if (is_space && !line.empty() && line.back() != ' ') line += ' ';
  }
  return line;
}

TaskFormula ReadFormula(TomlTable* table, const Reading& reading, bool with_actions) {
  const std::string text = OnOneLine(table->Text("expression"));
  try {
    return TaskFormula(text, reading.task, *reading.model, reading.state_of_joint, with_actions);
  } catch (const InvalidInput& error) {
    table->Fail("expression", error.what());
  }
}

void ReadReward(TomlTable table, Reading* reading) {
  const int given = table.Has("residuals") + table.Has("distance") + table.Has("expression");
  if (given != 1) table.FailHere("must have one of residuals, distance and expression");
  Task& task = reading->task;
  if (table.Has("residuals")) task.reward = ReadResiduals(&table, *reading);
  if (table.Has("distance")) task.reward = ReadDistance(&table, *reading);
  if (table.Has("expression")) {
    TaskFormula formula = ReadFormula(&table, *reading, true);
    const bool unit_interval = table.Flag("unit_interval", false);
    task.reward = MakeFormulaReward(std::move(formula), unit_interval);
  }
  task.learn_reward = table.Flag("unknown", false);
  table.CheckNoOthers();
}

void ReadSolved(TomlTable table, Reading* reading) {
  Task& task = reading->task;
  TaskFormula formula = ReadFormula(&table, *reading, false);
  const int second = static_cast<int>(std::lround(1 / task.control_period));
  const int n_steps = table.Integer("steps", {0, static_cast<double>(task.horizon)},
                                    std::clamp(second, 1, task.horizon));
  task.solved_description =
      formula.text() + " throughout the last " + std::to_string(n_steps) + " steps";
  task.solved = MakeSolvedTest(std::move(formula), task.features, task.n_states(), n_steps);
  table.CheckNoOthers();
}

// Widths that suit in general: the built-in tasks have 0.05 and 0.2, 0.5 and 1 of the bound.
void ReadPolicyAndSearch(TomlTable* root, Task* task) {
  if (std::optional<TomlTable> policy = root->Table("policy")) {
    task->parameter_bound = policy->Number("parameter_bound", kPositive, 5);
    task->policy_points = policy->Integer("points", {1, kMaxPolicyPoints}, 10);
    policy->CheckNoOthers();
  }
  task->search_first_sigma = 0.1 * task->parameter_bound;
  task->search_restart_sigma = task->parameter_bound;
  task->search_restart_decades = 1.3;
  if (std::optional<TomlTable> search = root->Table("search")) {
    task->search_first_sigma = search->Number("first_sigma", kPositive, task->search_first_sigma);
    task->search_restart_sigma =
        search->Number("restart_sigma", kPositive, task->search_restart_sigma);
    task->search_restart_decades = search->Number("restart_decades", {0, 10}, 1.3);
    search->CheckNoOthers();
  }
}

// The table of that name, which must be there.
TomlTable Part(TomlTable* root, const std::string& key) {
  std::optional<TomlTable> table = root->Table(key);
  if (!table) root->Fail(key, "must be a table");
  return *table;
}

// The system, made once to see that the model fits; its sensors and sites at the start.
void CheckSystem(Reading* reading) {
  Task& task = reading->task;
  const std::unique_ptr<System> system = MakeMujocoSystem(reading->spec);
  const std::vector<double> start = task.start_mean;
  system->Begin(1, start, task.start_mean);
}

}  // namespace

bool IsTaskFile(const std::string& name) { return name.ends_with(kEnding); }

std::string TaskModelFile(const std::string& file) {
  const toml::table table = Parse(file);
  TomlTable root(table, file, "");
  return ModelFile(&root, file);
}

Task LoadTomlTask(const std::string& file, const std::string& mjcf_file) {
  const toml::table table = Parse(file);
  TomlTable root(table, file, "");
  Reading reading;
  Task& task = reading.task;
  task.name = fs::path(file).stem().string();
  task.preset = kOwnPreset;
  task.description = root.Text("description");
  reading.spec.name = file;
  reading.spec.mjcf_file = ModelFile(&root, file);
  if (!mjcf_file.empty()) reading.spec.mjcf_file = mjcf_file;
  reading.spec.other_joints = true;
  reading.model = LoadMujocoModel(reading.spec);
  reading.state_of_joint.assign(reading.model->njnt, -1);
  task.control_period = root.Number("control_period", {0, 1000, true});
  task.horizon = root.Integer("horizon", {1, 1000000});
  for (const TomlTable& state : root.Tables("states")) ReadState(state, &reading);
  for (const TomlTable& action : root.Tables("actions")) ReadAction(action, &reading);
  reading.spec.action_limits = task.action_limits;
  reading.spec.control_period = task.control_period;
  CheckSystem(&reading);
  ReadReward(Part(&root, "reward"), &reading);
  ReadSolved(Part(&root, "solved"), &reading);
  ReadPolicyAndSearch(&root, &task);
  root.CheckNoOthers();
  SimulateByMujoco(reading.spec, &task);
  task.model_digest = Checksum(ReadFile(file) + task.model_digest);
  return task;
}

}  // namespace downpour
