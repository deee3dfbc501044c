// SPDX-License-Identifier: Apache-2.0
#include "tools/python/task_arguments.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "engine/rollout/evaluator.h"

namespace downpour::python {
namespace {

constexpr int kDefaultHorizon = 40;

// i, ("cos", i) or ("sin", i).
Feature ToFeature(py::handle value, int at, int n_states) {
  const std::string name = "features[" + std::to_string(at) + "]";
  Feature feature{FeatureKind::kIdentity, 0};
  py::object index = py::reinterpret_borrow<py::object>(value);
  if (py::isinstance<py::tuple>(value) || py::isinstance<py::list>(value)) {
    const auto pair = py::cast<py::tuple>(py::tuple(index));
    if (pair.size() != 2) {
      throw py::value_error(name + ": must be i, (\"cos\", i) or (\"sin\", i)");
    }
    const bool sine = ToChoice(pair[0], name + "[0]", {"cos", "sin"}) == 1;
    feature.kind = sine ? FeatureKind::kSine : FeatureKind::kCosine;
    index = pair[1];
  }
  feature.state_index = static_cast<int>(ToInteger(index, name, 0, n_states - 1));
  return feature;
}

std::vector<Variable> Names(const char* prefix, int n) {
  std::vector<Variable> names;
  for (int i = 0; i < n; ++i) names.push_back({prefix + std::to_string(i), ""});
  return names;
}

// A positive limit of each action, from a scalar or (A,).
std::vector<double> ToLimits(py::handle value, py::ssize_t n_actions) {
  std::vector<double> limits;
  const py::array array = py::array::ensure(value);
  if (array && array.ndim() == 0) {
    limits.assign(static_cast<std::size_t>(std::max<py::ssize_t>(n_actions, 1)),
                  ToNumber(value, "action_limit"));
  } else {
    limits = ToVector(value, "action_limit", {"A", n_actions});
  }
  for (const double limit : limits) {
    if (!(limit > 0)) throw py::value_error("action_limit: must be > 0");
  }
  return limits;
}

}  // namespace

std::string ToText(py::handle value, const char* name) {
  if (py::isinstance<py::str>(value)) return value.cast<std::string>();
  throw py::type_error(std::string(name) + " = " + std::string(py::repr(value)) +
                       ": must be a string");
}

Task CustomTask(const MultiOutputGp& model, const py::object& features, py::handle action_limit,
                bool own_features) {
  Task task;
  task.name = "custom";
  task.states = Names("state", model.n_outputs());
  if (own_features) {
    if (action_limit.is_none()) {
      throw py::type_error(
          "action_limit: must be given with a callable for features, (A,) or a "
          "scalar for one action");
    }
    const auto n_actions = static_cast<int>(ToLimits(action_limit, -1).size());
    const int n_features = model.n_inputs() - n_actions;
    task.features.assign(static_cast<std::size_t>(std::max(n_features, 0)),
                         {FeatureKind::kIdentity, 0});
  } else if (features.is_none()) {
    for (int e = 0; e < model.n_outputs(); ++e) {
      task.features.push_back({FeatureKind::kIdentity, e});
    }
  } else {
    if (!py::isinstance<py::sequence>(features) || py::isinstance<py::str>(features)) {
      throw py::type_error("features = " + std::string(py::repr(features)) +
                           ": must be None, a list or a callable");
    }
    for (const py::handle item : features) {
      task.features.push_back(ToFeature(item, task.n_features(), model.n_outputs()));
    }
  }
  const int n_actions = model.n_inputs() - task.n_features();
  if (task.features.empty() || n_actions < 1) {
    throw py::value_error("features: " + std::to_string(task.n_features()) + " features leave " +
                          std::to_string(n_actions) + " of the model's " +
                          std::to_string(model.n_inputs()) +
                          " inputs for actions, must leave 1 at least and begin with 1 feature");
  }
  task.feature_names = Names("feature", task.n_features());
  task.actions = Names("action", n_actions);
  task.action_limits.assign(static_cast<std::size_t>(n_actions),
                            std::numeric_limits<double>::infinity());
  task.start_mean.assign(task.states.size(), std::numeric_limits<double>::quiet_NaN());
  task.start_std.assign(task.states.size(), 0.0);
  task.observation_std.assign(task.states.size(), 0.0);
  task.policy_input_scale.assign(task.features.size(), 1.0);
  task.horizon = kDefaultHorizon;
  return task;
}

void SetTask(py::handle horizon, py::handle start, py::handle start_std, py::handle action_limit,
             Task* task) {
  const py::ssize_t n_states = task->n_states();
  if (!horizon.is_none()) {
    task->horizon = static_cast<int>(ToInteger(horizon, "horizon", 1, 1000000));
  }
  if (!start.is_none()) task->start_mean = ToVector(start, "start", {"E", n_states});
  if (std::isnan(task->start_mean.front())) {
    throw py::type_error("start: must be given without a task, (E,) with E = " +
                         std::to_string(n_states));
  }
  for (const double x : task->start_mean) {
    if (std::abs(x) > Evaluator::kStateLimit)
      throw py::value_error("start: must be within +-30000");
  }
  if (!start_std.is_none()) {
    task->start_std = ToVector(start_std, "start_std", {"E", n_states});
    for (const double std : task->start_std) {
      if (!(std >= 0)) throw py::value_error("start_std: must be >= 0");
    }
  }
  if (!action_limit.is_none()) task->action_limits = ToLimits(action_limit, task->n_actions());
}

PolicyOptions ToPolicyOptions(py::handle policy, py::handle hidden_units, py::handle activation,
                              py::handle points) {
  PolicyOptions options;
  options.kind = static_cast<PolicyKind>(
      ToChoice(policy, "policy", {kPolicyKindNames.begin(), kPolicyKindNames.end()}));
  options.hidden_units.clear();
  if (!py::isinstance<py::sequence>(hidden_units)) {
    throw py::type_error("hidden_units = " + std::string(py::repr(hidden_units)) +
                         ": must be a list of integers");
  }
  for (const py::handle units : hidden_units) {
    options.hidden_units.push_back(static_cast<int>(ToInteger(units, "hidden_units", 1, 256)));
  }
  options.activation = static_cast<Activation>(
      ToChoice(activation, "activation", {kActivationNames.begin(), kActivationNames.end()}));
  options.points = static_cast<int>(ToInteger(points, "points", 0, kMaxPolicyPoints));
  return options;
}

}  // namespace downpour::python
