// SPDX-License-Identifier: Apache-2.0
#include "tasks/mujoco_prior.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <sstream>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "kernels/aligned.h"
#include "tasks/model_digest.h"

namespace downpour {
namespace {

using ModelPtr = std::unique_ptr<mjModel, decltype(&mj_deleteModel)>;

// Everything that is fixed to a body goes with its length.
void SetLength(mjModel* m, int body, double factor) {
  for (int i = 0; i < 3; ++i) {
    m->body_ipos[3 * body + i] *= factor;
    m->body_inertia[3 * body + i] *= factor * factor;
  }
  for (int child = 1; child < m->nbody; ++child) {
    if (m->body_parentid[child] != body) continue;
    for (int i = 0; i < 3; ++i) m->body_pos[3 * child + i] *= factor;
  }
  for (int site = 0; site < m->nsite; ++site) {
    if (m->site_bodyid[site] != body) continue;
    for (int i = 0; i < 3; ++i) m->site_pos[3 * site + i] *= factor;
  }
}

void SetMass(mjModel* m, int body, double mass) {
  for (int i = 0; i < 3; ++i) m->body_inertia[3 * body + i] *= mass / m->body_mass[body];
  m->body_mass[body] = mass;
}

// What can be free: of which kind of object, and how to read and set it in a model that has the
// file's values otherwise.
struct Quantity {
  const char* name;
  mjtObj object;
  const char* object_name;
  const char *slide_unit, *unit;  // of a slide joint or what drives one, and else
  bool positive;                  // else >= 0
  double (*get)(const mjModel& m, int id);
  void (*set)(mjModel* m, int id, double value);
};

int Dof(const mjModel& m, int joint) { return m.jnt_dofadr[joint]; }

const std::array kQuantities = {
    Quantity{"mass", mjOBJ_BODY, "body", "kg", "kg", true,
             [](const mjModel& m, int id) { return m.body_mass[id]; }, SetMass},
    Quantity{"length", mjOBJ_BODY, "body", "1", "1", true, [](const mjModel&, int) { return 1.0; },
             SetLength},
    Quantity{"damping", mjOBJ_JOINT, "joint", "N s/m", "N m s/rad", false,
             [](const mjModel& m, int id) { return m.dof_damping[Dof(m, id)]; },
             [](mjModel* m, int id, double x) { m->dof_damping[Dof(*m, id)] = x; }},
    Quantity{"friction", mjOBJ_JOINT, "joint", "N", "N m", false,
             [](const mjModel& m, int id) { return m.dof_frictionloss[Dof(m, id)]; },
             [](mjModel* m, int id, double x) { m->dof_frictionloss[Dof(*m, id)] = x; }},
    Quantity{"stiffness", mjOBJ_JOINT, "joint", "N/m", "N m/rad", false,
             [](const mjModel& m, int id) { return m.jnt_stiffness[id]; },
             [](mjModel* m, int id, double x) { m->jnt_stiffness[id] = x; }},
    Quantity{"armature", mjOBJ_JOINT, "joint", "kg", "kg m^2", false,
             [](const mjModel& m, int id) { return m.dof_armature[Dof(m, id)]; },
             [](mjModel* m, int id, double x) { m->dof_armature[Dof(*m, id)] = x; }},
    Quantity{"gear", mjOBJ_ACTUATOR, "actuator", "1", "1", false,
             [](const mjModel& m, int id) { return m.actuator_gear[6 * id]; },
             [](mjModel* m, int id, double x) { m->actuator_gear[6 * id] = x; }},
};

struct FreeParameter {
  const Quantity* quantity;
  int id;
};

[[noreturn]] void FailFree(const std::string& entry, const std::string& what) {
  throw InvalidInput("prior.free: \"" + entry + "\": " + what);
}

std::string Text(double value) {
  std::ostringstream text;
  text.precision(17);
  text << value;
  return text.str();
}

std::string Trimmed(const std::string& text) {
  const std::size_t first = text.find_first_not_of(' ');
  if (first == std::string::npos) return "";
  return text.substr(first, text.find_last_not_of(' ') - first + 1);
}

std::vector<std::string> SplitList(const std::string& list) {
  std::vector<std::string> entries;
  if (Trimmed(list).empty()) return entries;
  std::stringstream stream(list + ",");
  for (std::string entry; std::getline(stream, entry, ',');) entries.push_back(Trimmed(entry));
  return entries;
}

const Quantity& FindQuantity(const std::string& entry, const std::string& name) {
  std::string allowed;
  for (const Quantity& quantity : kQuantities) {
    if (name == quantity.name) return quantity;
    allowed += (allowed.empty() ? "" : ", ") + std::string(quantity.name);
  }
  FailFree(entry, "unknown quantity " + name + "; allowed: " + allowed);
}

int FindObject(const mjModel& m, const Quantity& quantity, const std::string& entry,
               const std::string& name, const std::string& file) {
  const int id = mj_name2id(&m, quantity.object, name.c_str());
  const bool is_world = quantity.object == mjOBJ_BODY && id == 0;
  if (id >= 0 && !is_world) return id;
  const std::array counts = {m.nbody, m.njnt, m.nu};
  const int kind = quantity.object == mjOBJ_BODY ? 0 : quantity.object == mjOBJ_JOINT ? 1 : 2;
  std::string allowed;
  for (int i = kind == 0 ? 1 : 0; i < counts[kind]; ++i) {
    const char* other = mj_id2name(&m, quantity.object, i);
    if (other != nullptr) allowed += (allowed.empty() ? "" : ", ") + std::string(other);
  }
  FailFree(entry,
           file + " has no " + quantity.object_name + " named " + name + "; allowed: " + allowed);
}

bool ParseNumber(const std::string& text, double* value) {
  char* end = nullptr;
  *value = std::strtod(text.c_str(), &end);
  return !text.empty() && *end == '\0' && std::isfinite(*value);
}

// "LOW..HIGH", or "" for from half to twice the model's own value.
void ReadRange(const std::string& entry, const std::string& range, const Quantity& quantity,
               PriorParameter* parameter) {
  const double own = parameter->initial;
  if (range.empty()) {
    if (!(own > 0)) {
      FailFree(entry,
               "is " + Text(own) + " in the model; must have a range of its own, =LOW..HIGH");
    }
    parameter->low = own / 2;
    parameter->high = own * 2;
    return;
  }
  const std::size_t dots = range.find("..");
  const bool numbers = dots != std::string::npos &&
                       ParseNumber(Trimmed(range.substr(0, dots)), &parameter->low) &&
                       ParseNumber(Trimmed(range.substr(dots + 2)), &parameter->high);
  if (!numbers || !(parameter->low < parameter->high) ||
      !(quantity.positive ? parameter->low > 0 : parameter->low >= 0)) {
    FailFree(entry, std::string("must have a range LOW..HIGH of finite numbers with LOW < HIGH, ") +
                        (quantity.positive ? "above 0" : "not below 0"));
  }
  if (!(own >= parameter->low && own <= parameter->high)) {
    FailFree(entry, "is " + Text(own) + " in the model; the range must contain that");
  }
}

// True for a slide joint, or an actuator or a body's: units differ from those of a hinge.
bool IsSlide(const mjModel& m, const Quantity& quantity, int id) {
  return quantity.object == mjOBJ_JOINT && m.jnt_type[id] == mjJNT_SLIDE;
}

class MujocoPredictor final : public PriorPredictor {
 public:
  MujocoPredictor(const MujocoSystemSpec& spec, std::vector<FreeParameter> free)
      : system_(MakeMujocoSystem(spec)),
        original_(mj_copyModel(nullptr, &system_->model()), &mj_deleteModel),
        free_(std::move(free)),
        state_(spec.states.size()),
        action_(spec.actuators.size()) {}

  void SetParameters(std::span<const double> values) override {
    mjModel* const model = &system_->model();
    mj_copyModel(model, original_.get());
    for (std::size_t i = 0; i < free_.size(); ++i) {
      free_[i].quantity->set(model, free_[i].id, values[i]);
    }
    // What MuJoCo derives from masses and lengths.
    mj_setConst(model, &system_->data());
    system_->Reset(std::vector<double>(state_.size(), 0.0));
  }

  void PredictTile(int n, const double* states, const double* actions, double* next) override {
    for (int lane = 0; lane < n; ++lane) {
      for (std::size_t e = 0; e < state_.size(); ++e) state_[e] = states[e * kTileLanes + lane];
      for (std::size_t a = 0; a < action_.size(); ++a) action_[a] = actions[a * kTileLanes + lane];
      Step();
      for (std::size_t e = 0; e < state_.size(); ++e) next[e * kTileLanes + lane] = state_[e];
    }
  }

 private:
  // No prediction where MuJoCo gives up, as for want of memory for contacts.
  void Step() {
    try {
      system_->Place(state_);
      system_->Step(action_, state_);
    } catch (const InvalidInput&) {
      std::fill(state_.begin(), state_.end(), 0.0);
      system_->Reset(state_);
      std::fill(state_.begin(), state_.end(), std::numeric_limits<double>::quiet_NaN());
    }
  }

  std::unique_ptr<MujocoSystem> system_;
  ModelPtr original_;
  std::vector<FreeParameter> free_;
  std::vector<double> state_, action_;  // of one lane
};

class MujocoPrior final : public DynamicsPrior {
 public:
  MujocoPrior(const MujocoSystemSpec& spec, const std::string& free)
      : spec_(spec), digest_(ModelDigest(spec)) {
    for (const JointState& state : spec_.states) {
      if (state.sensor.empty() && state.site.empty()) continue;
      throw InvalidInput("prior.model: the task has states of " +
                         (state.site.empty() ? "sensor " + state.sensor : "site " + state.site) +
                         "; allowed: tasks whose states are positions and velocities of joints");
    }
    const std::unique_ptr<MujocoSystem> system = MakeMujocoSystem(spec_);
    for (const std::string& entry : SplitList(free)) AddParameter(system->model(), entry);
  }

  std::string Describe() const override {
    std::string text = "MuJoCo model with digest " + digest_;
    for (const PriorParameter& p : parameters_) {
      text += ", " + p.name + " = " + Text(p.low) + ".." + Text(p.high);
    }
    return text;
  }
  const std::vector<PriorParameter>& parameters() const override { return parameters_; }

  std::unique_ptr<PriorPredictor> MakePredictor() const override {
    auto predictor = std::make_unique<MujocoPredictor>(spec_, free_);
    if (ModelDigest(spec_) != digest_) {
      throw InvalidInput(spec_.mjcf_file + ": has changed since the run was begun or resumed");
    }
    return predictor;
  }

 private:
  void AddParameter(const mjModel& model, const std::string& entry) {
    const std::size_t equals = entry.find('=');
    const std::string name = Trimmed(entry.substr(0, equals));
    const std::size_t colon = name.rfind(':');
    if (colon == std::string::npos || colon == 0 || colon + 1 == name.size()) {
      FailFree(entry,
               "must be OBJECT:QUANTITY or OBJECT:QUANTITY=LOW..HIGH, e.g. pole:mass=0.1..1");
    }
    const Quantity& quantity = FindQuantity(entry, name.substr(colon + 1));
    const int id = FindObject(model, quantity, entry, name.substr(0, colon), spec_.mjcf_file);
    for (const PriorParameter& other : parameters_) {
      if (other.name == name) FailFree(entry, "must be there once");
    }
    PriorParameter parameter;
    parameter.name = name;
    parameter.unit = IsSlide(model, quantity, id) ? quantity.slide_unit : quantity.unit;
    parameter.initial = quantity.get(model, id);
    std::string range = equals == std::string::npos ? "" : Trimmed(entry.substr(equals + 1));
    if (equals != std::string::npos && range.empty()) range = "..";
    ReadRange(entry, range, quantity, &parameter);
    if (quantity.positive && !(parameter.initial > 0)) {
      FailFree(entry, "is " + Text(parameter.initial) + " in the model; must be > 0");
    }
    parameters_.push_back(parameter);
    free_.push_back({&quantity, id});
  }

  MujocoSystemSpec spec_;
  std::string digest_;
  std::vector<PriorParameter> parameters_;
  std::vector<FreeParameter> free_;
};

}  // namespace

std::shared_ptr<const DynamicsPrior> MakeMujocoPrior(const MujocoSystemSpec& spec,
                                                     const std::string& free) {
  return std::make_shared<MujocoPrior>(spec, free);
}

std::function<std::shared_ptr<const DynamicsPrior>(const std::string&, const std::string&)>
MujocoPriorMaker(const MujocoSystemSpec& spec) {
  return [spec](const std::string& mjcf_file, const std::string& free) {
    MujocoSystemSpec of_prior = spec;
    of_prior.mjcf_file = mjcf_file;
    return MakeMujocoPrior(of_prior, free);
  };
}

}  // namespace downpour
