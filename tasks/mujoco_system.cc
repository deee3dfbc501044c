// SPDX-License-Identifier: Apache-2.0
#include "tasks/mujoco_system.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <span>
#include <sstream>
#include <system_error>

#include "engine/errors.h"

namespace downpour {
namespace {

using ModelPtr = std::unique_ptr<mjModel, void (*)(mjModel*)>;
using DataPtr = std::unique_ptr<mjData, decltype(&mj_deleteData)>;

constexpr int kMaxSubsteps = 100000;

// MuJoCo's messages span several lines.
std::string OneLine(const std::string& text) {
  std::string line;
  for (const char c : text) {
    if (std::isspace(static_cast<unsigned char>(c))) {
      if (!line.empty() && line.back() != ' ') line += ' ';
    } else {
      line += c;
    }
  }
  while (!line.empty() && line.back() == ' ') line.pop_back();
  return line;
}

std::string Listed(const std::vector<std::string>& names) {
  std::string list;
  for (const std::string& name : names) list += (list.empty() ? "" : ", ") + name;
  return list;
}

// Without handlers MuJoCo ends the process on an error and appends warnings to MUJOCO_LOG.TXT.
void InstallHandlers() {
  static const bool installed = [] {
    mju_user_error = [](const char* message) { throw InvalidInput(OneLine(message)); };
    mju_user_warning = [](const char*) {};
    return true;
  }();
  static_cast<void>(installed);
}

[[noreturn]] void Fail(const std::string& model_name, const std::string& what) {
  throw InvalidInput(OneLine(model_name + ": " + what));
}

std::string ModelName(const MujocoSystemSpec& spec) {
  return spec.mjcf_file.empty() ? spec.name : spec.mjcf_file;
}

// MuJoCo names a missing file and a folder by error numbers only.
void CheckReadable(const std::string& file) {
  errno = 0;
  std::ifstream in(file, std::ios::binary);
  if (in) in.peek();
  if (!in.is_open() || in.bad()) {
    const int reason = errno != 0 ? errno : EIO;
    Fail(file, "cannot be read (" + std::generic_category().message(reason) +
                   "); allowed: a readable MJCF file");
  }
}

ModelPtr LoadModel(const MujocoSystemSpec& spec, const std::string& model_name) {
  char message[1000] = "";
  mjModel* model = nullptr;
  if (!spec.mjcf_file.empty()) {
    CheckReadable(spec.mjcf_file);
    model = mj_loadXML(spec.mjcf_file.c_str(), nullptr, message, sizeof message);
  } else {
    const auto vfs = std::make_unique<mjVFS>();  // 2 MB: too large for a thread's stack
    mj_defaultVFS(vfs.get());
    mj_makeEmptyFileVFS(vfs.get(), "model.xml", static_cast<int>(spec.mjcf.size()));
    std::memcpy(vfs->filedata[0], spec.mjcf.data(), spec.mjcf.size());
    model = mj_loadXML("model.xml", vfs.get(), message, sizeof message);
    mj_deleteVFS(vfs.get());
  }
  if (model == nullptr) {
    Fail(model_name, std::string("MuJoCo cannot use it (") + message +
                         "); allowed: an MJCF model that MuJoCo " + mj_versionString() +
                         " compiles");
  }
  return ModelPtr(model, &mj_deleteModel);
}

// Ids of exactly the objects named, or, with others, of them; `kind` is "joint" or "actuator".
std::vector<int> FindAll(const mjModel& model, mjtObj type, int n_in_model, const std::string& kind,
                         const std::vector<std::string>& names, bool others,
                         const std::string& model_name) {
  const std::string allowed =
      "; allowed: " + std::string(others ? "" : "exactly ") + "the " + kind + "s " + Listed(names);
  std::vector<int> ids;
  for (const std::string& name : names) {
    ids.push_back(mj_name2id(&model, type, name.c_str()));
    if (ids.back() < 0) Fail(model_name, "has no " + kind + " named " + name + allowed);
  }
  if (!others && n_in_model != static_cast<int>(names.size())) {
    Fail(model_name, "has " + std::to_string(n_in_model) + " " + kind + "s" + allowed);
  }
  return ids;
}

int CountSubsteps(double control_period, double timestep, const std::string& model_name) {
  const double ratio = control_period / timestep;
  const double n_substeps = std::round(ratio);
  if (!(n_substeps >= 1 && n_substeps <= kMaxSubsteps &&
        std::abs(ratio - n_substeps) <= 1e-9 * n_substeps)) {
    std::ostringstream what;
    what << "has timestep " << timestep << " s; allowed: the control period " << control_period
         << " s divided by a whole number from 1 to " << kMaxSubsteps;
    Fail(model_name, what.str());
  }
  return static_cast<int>(n_substeps);
}

// A control that MuJoCo clips would not be the action that the model learns from.
void CheckControlRanges(const mjModel& model, const std::vector<int>& actuators,
                        const MujocoSystemSpec& spec, const std::string& model_name) {
  for (std::size_t i = 0; i < actuators.size(); ++i) {
    if (!model.actuator_ctrllimited[actuators[i]]) continue;
    const double* const range = model.actuator_ctrlrange + 2 * actuators[i];
    const double limit = spec.action_limits[i];
    if (range[0] <= -limit && range[1] >= limit) continue;
    std::ostringstream what;
    what << "actuator " << spec.actuators[i] << " has ctrlrange " << range[0] << " to " << range[1]
         << "; allowed: one that contains " << -limit << " to " << limit
         << ", the task's action limits, or ctrllimited=\"false\"";
    Fail(model_name, what.str());
  }
}

class LoadedSystem final : public MujocoSystem {
 public:
  LoadedSystem(const MujocoSystemSpec& spec, const std::string& model_name)
      : model_(LoadModel(spec, model_name)), data_(mj_makeData(model_.get()), &mj_deleteData) {
    const std::vector<int> joints = FindAll(*model_, mjOBJ_JOINT, model_->njnt, "joint",
                                            spec.joints, spec.other_joints, model_name);
    actuators_ =
        FindAll(*model_, mjOBJ_ACTUATOR, model_->nu, "actuator", spec.actuators, false, model_name);
    CheckControlRanges(*model_, actuators_, spec, model_name);
    for (std::size_t i = 0; i < joints.size(); ++i) {
      const int type = model_->jnt_type[joints[i]];
      if (type != mjJNT_SLIDE && type != mjJNT_HINGE) {
        Fail(model_name, "joint " + spec.joints[i] + " has more than one degree of freedom" +
                             "; allowed: slide, hinge");
      }
    }
    n_substeps_ = CountSubsteps(spec.control_period, model_->opt.timestep, model_name);
    for (const JointState& state : spec.states) {
      if (!state.sensor.empty() || !state.site.empty()) {
        follows_.push_back(true);
        variables_.push_back(state.site.empty() ? SensorReading(state, model_name)
                                                : SitePlace(state, model_name));
        continue;
      }
      follows_.push_back(false);
      const int joint = joints[state.joint];
      variables_.push_back(state.quantity == JointQuantity::kPosition
                               ? data_->qpos + model_->jnt_qposadr[joint]
                               : data_->qvel + model_->jnt_dofadr[joint]);
    }
  }

  void Reset(std::span<const double> state) override {
    mj_resetData(model_.get(), data_.get());
    SetJoints(state);
  }

  void Begin(int, std::span<const double> start, std::span<double> state) override {
    Reset(start);
    UpdateFollowing();
    for (std::size_t i = 0; i < variables_.size(); ++i) state[i] = *variables_[i];
  }

  void Place(std::span<const double> state) override {
    if (!Stable()) mj_resetData(model_.get(), data_.get());
    data_->time = 0;
    std::copy_n(model_->qpos0, model_->nq, data_->qpos);
    std::fill_n(data_->qvel, model_->nv, 0.0);
    std::fill_n(data_->act, model_->na, 0.0);
    std::fill_n(data_->qacc_warmstart, model_->nv, 0.0);
    SetJoints(state);
  }

  void Step(std::span<const double> action, std::span<double> state) override {
    StepObserved(action, state, [] {});
  }

  void StepObserved(std::span<const double> action, std::span<double> state,
                    const std::function<void()>& observe) override {
    for (std::size_t i = 0; i < actuators_.size(); ++i) data_->ctrl[actuators_[i]] = action[i];
    for (int substep = 0; substep < n_substeps_; ++substep) {
      mj_step(model_.get(), data_.get());
      observe();
    }
    UpdateFollowing();
    // MuJoCo replaces what is not finite and goes on from there: not a state of this system.
    const bool stable = Stable();
    for (std::size_t i = 0; i < variables_.size(); ++i) {
      state[i] = stable ? *variables_[i] : std::numeric_limits<double>::quiet_NaN();
    }
  }

  mjModel& model() override { return *model_; }
  mjData& data() override { return *data_; }

 private:
  void SetJoints(std::span<const double> state) {
    for (std::size_t i = 0; i < variables_.size(); ++i) {
      if (!follows_[i]) *variables_[i] = state[i];
    }
  }

  double* SensorReading(const JointState& state, const std::string& model_name) const {
    const int sensor = mj_name2id(model_.get(), mjOBJ_SENSOR, state.sensor.c_str());
    if (sensor < 0) Fail(model_name, "has no sensor named " + state.sensor);
    if (state.component >= model_->sensor_dim[sensor]) {
      Fail(model_name, "sensor " + state.sensor + " has " +
                           std::to_string(model_->sensor_dim[sensor]) +
                           " numbers; allowed: a component, from 0, below that");
    }
    return data_->sensordata + model_->sensor_adr[sensor] + state.component;
  }

  double* SitePlace(const JointState& state, const std::string& model_name) const {
    const int site = mj_name2id(model_.get(), mjOBJ_SITE, state.site.c_str());
    if (site < 0) Fail(model_name, "has no site named " + state.site);
    return data_->site_xpos + 3 * site + state.component;
  }

  // mj_step leaves them as they were before the last timestep.
  void UpdateFollowing() {
    if (std::find(follows_.begin(), follows_.end(), true) == follows_.end()) return;
    mj_forward(model_.get(), data_.get());
  }

  bool Warned(mjtWarning warning) const { return data_->warning[warning].number > 0; }
  bool Stable() const {
    return !Warned(mjWARN_BADQPOS) && !Warned(mjWARN_BADQVEL) && !Warned(mjWARN_BADQACC) &&
           !Warned(mjWARN_BADCTRL);
  }

  ModelPtr model_;
  DataPtr data_;
  std::vector<double*> variables_;  // into data_, in the order of the state
  std::vector<bool> follows_;       // from the joints: sensors and sites
  std::vector<int> actuators_;
  int n_substeps_ = 0;
};

}  // namespace

ModelPtr LoadMujocoModel(const MujocoSystemSpec& spec) {
  InstallHandlers();
  return LoadModel(spec, ModelName(spec));
}

std::unique_ptr<MujocoSystem> MakeMujocoSystem(const MujocoSystemSpec& spec) {
  InstallHandlers();
  return std::make_unique<LoadedSystem>(spec, ModelName(spec));
}

}  // namespace downpour
