// SPDX-License-Identifier: Apache-2.0
#include "tools/python/learn.h"

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "engine/learner/learner.h"
#include "engine/learner/learnt_policy.h"
#include "tools/downpour/config.h"
#include "tools/downpour/prior.h"
#include "tools/python/calls.h"
#include "tools/python/interrupt.h"
#include "tools/python/task_arguments.h"

namespace downpour::python {
namespace {

constexpr char kDoc[] =
    R"(learn(task, seed=0, episodes=15, callback=None, threads=0, settings=None) -> LearnResult

Learns a policy for a built-in task (downpour.tasks()) from scratch by Black-DROPS, as `downpour learn`
does, and with the same bits: episode after episode, a model of all data so far, a search for the best
policy on it, and its trial on the simulator.

episodes  random ones (the first) included, [2, 1000]
callback  called after each episode with the dict that LearnResult.episodes holds of it; what it
          raises ends the learning
threads   0: all cores. Never changes a result
settings  dict of the other settings by the names that config.toml has, e.g.
          {"search.evaluations": 50000, "policy.kind": "gp", "learn.until_solved": True}

Ctrl-C raises KeyboardInterrupt. ValueError names a setting that is wrong and what is allowed.)";

constexpr char kPolicyDoc[] =
    R"(A learnt policy: policy(state, step=0) -> action (A,), within +-action_limit.

state is (E,), as observed, in the units of the task; step is for policies that depend on time (dmp).)";

py::array_t<double> Act(const LearntPolicy& policy, py::handle state, py::handle step) {
  const std::vector<double> observed = ToVector(state, "state", {"E", policy.task().n_states()});
  const auto the_step = static_cast<int>(ToInteger(step, "step", 0, 1'000'000'000));
  std::vector<double> action(policy.task().n_actions());
  policy.Act(the_step, observed, action);
  return FromVector(action);
}

struct LearnResult {
  std::shared_ptr<LearntPolicy> policy;
  py::list episodes;
  py::dict transitions;
  bool solved = false;
};

py::dict ToDict(const EpisodeRecord& record) {
  py::dict row;
  row["episode"] = record.episode;
  row["random"] = record.random;
  row["points"] = record.points;
  row["interaction_seconds"] = record.interaction_seconds;
  row["real_return"] = record.real_return;
  row["predicted_return"] = record.predicted_return;
  row["solved"] = record.solved;
  row["evaluations"] = record.evaluations;
  row["gp_queries"] = record.gp_queries;
  row["model_seconds"] = record.model_seconds;
  row["search_seconds"] = record.search_seconds;
  row["parameters"] = FromVector(record.policy);
  return row;
}

py::dict ToArrays(const Task& task, const std::vector<Transition>& transitions) {
  std::vector<double> before, actions, after, rewards;
  std::vector<int> episodes, steps;
  for (const Transition& t : transitions) {
    before.insert(before.end(), t.observation.begin(), t.observation.end());
    actions.insert(actions.end(), t.action.begin(), t.action.end());
    after.insert(after.end(), t.next_observation.begin(), t.next_observation.end());
    rewards.push_back(t.reward);
    episodes.push_back(t.episode);
    steps.push_back(t.step);
  }
  py::dict arrays;
  arrays["episode"] = py::array_t<int>(static_cast<py::ssize_t>(episodes.size()), episodes.data());
  arrays["step"] = py::array_t<int>(static_cast<py::ssize_t>(steps.size()), steps.data());
  arrays["observation"] = FromRows(before, task.n_states());
  arrays["action"] = FromRows(actions, task.n_actions());
  arrays["next_observation"] = FromRows(after, task.n_states());
  arrays["reward"] = FromVector(rewards);
  return arrays;
}

// A setting as config.toml has it.
Setting ToSetting(const std::string& key, py::handle value) {
  Setting setting{"settings", key, {}, py::repr(value)};
  if (py::isinstance<py::bool_>(value)) {
    setting.value = value.cast<bool>();
  } else if (py::isinstance<py::str>(value)) {
    setting.value = value.cast<std::string>();
  } else if (py::isinstance<py::sequence>(value)) {
    std::vector<std::int64_t> list;
    for (const py::handle item : value) {
      list.push_back(ToInteger(item, key, INT64_MIN, INT64_MAX));
    }
    setting.value = list;
  } else if (PyIndex_Check(value.ptr()) != 0) {
    setting.value = ToInteger(value, key, INT64_MIN, INT64_MAX);
  } else {
    setting.value = ToNumber(value, key);
  }
  return setting;
}

std::vector<Setting> ToSettings(py::handle task, py::handle seed, py::handle episodes,
                                py::handle threads, const py::object& settings) {
  std::vector<Setting> list = {
      {"task", "task", ToText(task, "task"), ToText(task, "task")},
      {"seed", "learn.seed", static_cast<std::int64_t>(ToSeed(seed)), py::repr(seed)},
      {"episodes", "learn.episodes", ToInteger(episodes, "episodes", INT64_MIN, INT64_MAX),
       py::repr(episodes)},
      {"threads", "learn.threads", ToInteger(threads, "threads", INT64_MIN, INT64_MAX),
       py::repr(threads)}};
  if (settings.is_none()) return list;
  if (!py::isinstance<py::dict>(settings)) {
    throw py::type_error("settings = " + std::string(py::repr(settings)) + ": must be a dict");
  }
  for (const auto& [key, value] : settings.cast<py::dict>()) {
    const std::string name = ToText(key, "settings: key");
    list.push_back(ToSetting(name, value));
    RequireLibrarySetting(list.back());
  }
  return list;
}

LearnResult Learn(py::handle task, py::handle seed, py::handle episodes, const py::object& callback,
                  py::handle threads, const py::object& settings) {
  if (!callback.is_none() && PyCallable_Check(callback.ptr()) == 0) {
    throw py::type_error("callback = " + std::string(py::repr(callback)) +
                         ": must be None or a callable");
  }
  ResolvedRun run = ResolveConfig(ToSettings(task, seed, episodes, threads, settings));
  UsePrior(run.config, &run.task);
  Learner learner(run.task, run.config.learner);
  LearnResult result;
  std::vector<double> parameters;
  while (!learner.done()) {
    RunInterruptibly([&](const std::atomic<bool>* stop) {
      Learner::Callbacks callbacks;
      callbacks.stop = stop;
      learner.RunEpisode(callbacks);
    });
    const EpisodeRecord& record = learner.state().episodes.back();
    result.solved = result.solved || record.solved;
    if (!record.random) parameters = record.policy;
    const py::dict row = ToDict(record);
    result.episodes.append(row);
    if (!callback.is_none()) callback(row);
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
  }
  result.transitions = ToArrays(run.task, learner.state().transitions);
  // No parameters: until_solved, and the random episode was a solution.
  if (!parameters.empty()) {
    result.policy = std::make_shared<LearntPolicy>(
        run.task, MakePolicy(run.task, run.config.learner.policy), std::move(parameters));
  }
  return result;
}

}  // namespace

void AddLearn(py::module_* module) {
  using py::arg;
  const py::none none;
  py::class_<LearntPolicy, std::shared_ptr<LearntPolicy>>(*module, "Policy", kPolicyDoc)
      .def("__call__", &Act, arg("state"), arg("step") = 0)
      .def_property_readonly(
          "parameters", [](const LearntPolicy& policy) { return FromVector(policy.parameters()); },
          "(P,), as Evaluator takes them.")
      .def_property_readonly(
          "kind", [](const LearntPolicy& policy) { return policy.policy().kind(); },
          "'nn', 'linear', 'gp' or 'dmp'.")
      .def_property_readonly(
          "action_limit",
          [](const LearntPolicy& policy) { return FromVector(policy.task().action_limits); },
          "(A,)");
  py::class_<LearnResult>(*module, "LearnResult", "What learning came to.")
      .def_readonly("policy", &LearnResult::policy, "The last policy learnt.")
      .def_readonly("episodes", &LearnResult::episodes,
                    "A dict for each episode: episode (from 1), random, points (of the model), "
                    "interaction_seconds, real_return, predicted_return, solved, evaluations, "
                    "gp_queries, model_seconds, search_seconds, parameters (P,).")
      .def_readonly("transitions", &LearnResult::transitions,
                    "What was observed on the simulator, a row a step: observation (T, E), action "
                    "(T, A), next_observation (T, E), reward, episode, step (T,).")
      .def_readonly("solved", &LearnResult::solved, "Whether an episode solved the task.");
  module->def("learn", &Learn, arg("task"), arg("seed") = 0, arg("episodes") = 15,
              arg("callback") = none, arg("threads") = 0, arg("settings") = none, kDoc);
  RefuseOtherCalls(module, "learn", kDoc);
}

}  // namespace downpour::python
