// SPDX-License-Identifier: Apache-2.0
#include "tools/python/env.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "engine/rollout/reward.h"
#include "engine/rollout/task.h"
#include "kernels/philox/philox.h"
#include "tasks/registry.h"
#include "tools/python/calls.h"
#include "tools/python/task_arguments.h"

namespace downpour::python {
namespace {

constexpr char kDoc[] =
    R"(A built-in task on its simulator, in the manner of gym. Made by downpour.make(task).

    env = downpour.make("pendulum")
    obs = env.reset(seed=0)
    done = False
    while not done:
        obs, reward, done, info = env.step(u)

Observations (E,) are states with the task's observation noise, in the order of state_names. An episode
is over (done) after `horizon` steps; one step is control_period seconds. Not to be used by two threads
at once.)";

class Env {
 public:
  explicit Env(Task task) : task_(std::move(task)), system_(task_.make_system()) {}

  py::array_t<double> Reset(const py::object& seed) {
    if (seed.is_none()) {
      ++episode_;
    } else {
      seed_ = ToSeed(seed);
      episode_ = 0;
    }
    states_ = Noisy(task_.start_mean, task_.start_std, StreamPurpose::kStartState, 0);
    system_->Reset(states_);
    step_ = 0;
    return FromVector(Observe());
  }

  py::tuple Step(py::handle u) {
    if (step_ < 0 || step_ == task_.horizon) {
      throw std::runtime_error(step_ < 0 ? "Env.step: no episode, call reset first"
                                         : "Env.step: the episode is over, call reset");
    }
    std::vector<double> action = ToVector(u, "u", {"A", task_.n_actions()});
    for (std::size_t a = 0; a < action.size(); ++a) {
      action[a] = std::clamp(action[a], -task_.action_limits[a], task_.action_limits[a]);
    }
    std::vector<double> next(task_.states.size());
    system_->Step(action, next);
    const double reward = ComputeReward(task_, step_, next, action);
    states_.insert(states_.end(), next.begin(), next.end());
    ++step_;
    const bool done = step_ == task_.horizon;
    py::dict info;
    info["state"] = FromVector(next);
    info["action"] = FromVector(action);
    info["step"] = step_;
    if (done) info["solved"] = task_.solved(states_);
    return py::make_tuple(FromVector(Observe()), reward, done, info);
  }

  py::array_t<double> Features(py::handle states) const {
    const py::ssize_t n_states = task_.n_states(), n_features = task_.n_features();
    const py::array given = py::array::ensure(states);
    const bool one = given && given.ndim() == 1;
    const Doubles rows = one ? ToArray(states, "states", {{"E", n_states}})
                             : ToArray(states, "states", {{"n"}, {"E", n_states}});
    const py::ssize_t n = rows.size() / n_states;
    py::array_t<double> features({n, n_features});
    const std::span<const double> from = Span(rows);
    const std::span<double> to = MutableSpan(&features);
    for (py::ssize_t i = 0; i < n; ++i) {
      ComputeFeatures(task_, from.subspan(i * n_states, n_states),
                      to.subspan(i * n_features, n_features));
    }
    return one ? features.reshape({n_features}) : features;
  }

  const Task& task() const { return task_; }

 private:
  // mean + std z by the stream of this episode.
  std::vector<double> Noisy(std::span<const double> mean, const std::vector<double>& std,
                            StreamPurpose purpose, int counter) const {
    std::vector<double> sample(mean.size());
    FillNormals(DeriveKey(seed_, purpose, {episode_}), static_cast<std::uint32_t>(counter),
                sample.data(), sample.size());
    for (std::size_t i = 0; i < sample.size(); ++i) sample[i] = mean[i] + std[i] * sample[i];
    return sample;
  }

  std::vector<double> Observe() const {
    const std::size_t n_states = task_.states.size();
    return Noisy(std::span(states_).last(n_states), task_.observation_std,
                 StreamPurpose::kObservationNoise, step_);
  }

  Task task_;
  std::unique_ptr<System> system_;
  std::uint64_t seed_ = 0;
  std::uint32_t episode_ = 0;
  int step_ = -1;
  std::vector<double> states_;  // noise-free, of the episode so far
};

py::list NamesOf(const std::vector<Variable>& variables) {
  py::list names;
  for (const Variable& variable : variables) names.append(variable.name);
  return names;
}

}  // namespace

void AddEnv(py::module_* module) {
  using py::arg;
  py::class_<Env> type(*module, "Env", kDoc);
  type.def("reset", &Env::Reset, arg("seed") = py::none(),
           "reset(seed=None) -> obs (E,)\n\nBegins an episode. The same seed gives the same start "
           "and "
           "noise; None goes on with the next episode of the last seed (0 at first).")
      .def("step", &Env::Step, arg("u"),
           "step(u) -> (obs (E,), reward, done, info)\n\nHolds the action u (A,), clipped to "
           "+-action_limit, for a control period. info: state (E,) without noise, action as "
           "applied, step (from 1) and, when done, solved.")
      .def(
          "features", &Env::Features, arg("states"),
          "features(states) -> features\n\nWhat model and policy see: (n, F) of (n, E), or (F,) of "
          "(E,).")
      .def_property_readonly("task", [](const Env& env) { return env.task().name; })
      .def_property_readonly(
          "horizon", [](const Env& env) { return env.task().horizon; }, "Steps of an episode.")
      .def_property_readonly(
          "control_period", [](const Env& env) { return env.task().control_period; }, "s")
      .def_property_readonly(
          "action_limit", [](const Env& env) { return FromVector(env.task().action_limits); },
          "(A,), in the units of the actions.")
      .def_property_readonly("state_names",
                             [](const Env& env) { return NamesOf(env.task().states); })
      .def_property_readonly("feature_names",
                             [](const Env& env) { return NamesOf(env.task().feature_names); })
      .def_property_readonly("action_names",
                             [](const Env& env) { return NamesOf(env.task().actions); });
  RefuseOtherCalls(&type, "reset", "reset(seed=None)");
  RefuseOtherCalls(&type, "step", "step(u)");
  RefuseOtherCalls(&type, "features", "features(states)");
  module->def(
      "make",
      [](py::handle task, py::handle preset) {
        return std::make_unique<Env>(MakeTask(ToText(task, "task"), ToText(preset, "preset")));
      },
      arg("task"), arg("preset") = "",
      "make(task, preset=\"\") -> Env\n\nA built-in task on its simulator; downpour.tasks() "
      "lists them.");
  RefuseOtherCalls(module, "make", "make(task, preset=)");
  module->def(
      "tasks",
      [] {
        py::list names;
        for (const std::string& name : TaskNames()) names.append(name);
        return names;
      },
      "tasks() -> list\n\nNames of the built-in tasks.");
}

}  // namespace downpour::python
