// SPDX-License-Identifier: Apache-2.0
#include "tools/python/evaluator.h"

#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "engine/rollout/model_evaluator.h"
#include "tasks/registry.h"
#include "tools/python/block_callbacks.h"
#include "tools/python/calls.h"
#include "tools/python/gaussian_process.h"
#include "tools/python/interrupt.h"
#include "tools/python/task_arguments.h"

namespace downpour::python {
namespace {

constexpr char kDoc[] =
    R"(Evaluates parameter vectors of a policy by rollouts on a model: thousands at once.

Evaluator(model, task=None, features=None, policy="nn", reward=None, rollouts=1, horizon=None,
          start=None, action_limit=None, start_std=None, hidden_units=(10,), activation="tanh",
          points=0, use_variance=True, predict_noise=True, sample_clamp=0.0, preset="",
          threads=2)

The model's inputs are (features, action), its outputs the differences of the state over a step. A
rollout starts at start + start_std z, and at each step t of `horizon` acts, samples the differences
(mean + sqrt(variance + noise) z), and is rewarded for the new state.

model         GaussianProcess with D = F + A inputs and E outputs
task          a built-in task (downpour.tasks()), which gives features, reward, start, limits and
              horizon; what is given beside it comes first, but features are the task's
features      without a task. None: the states. A list: i (state i), ("cos", i) or ("sin", i). Or a
              callable features(states (lanes, E)) -> (lanes, F), with action_limit
policy        "nn" (hidden_units, activation "tanh" or "relu"), "linear", "gp" or "dmp" (points; 0:
              the task's), see docs/policies.md, or a callable policy(theta_block (lanes, P),
              features (lanes, F), t) -> (lanes, A)
reward        callable reward(states (lanes, E), actions (lanes, A), t) -> (lanes,) of the new states
              and the actions of step t that led there; None: the task's
rollouts      of each parameter vector
horizon       steps; None: the task's, or 40
start         (E,) in the units of the states, start_std likewise (None: the task's, or 0)
action_limit  scalar or (A,): actions are clipped to +-limit; None: the task's, or none
use_variance  False: no sampling, means only. predict_noise: add the noise variance. sample_clamp:
              samples stay within that many standard deviations, 0: anywhere
threads       0: all cores. Never changes a result

Callables are called once a time step with all lanes of the batch, a lane being a rollout. They get
arrays of their own in column-major order, so that columns are contiguous. What they raise ends the
call and is raised; a result of another shape, or with numbers that are not finite, raises ValueError.

A rollout whose state leaves +-30000, or whose reward is beyond +-1e6, has diverged; its return is
diverged_return. Objects do not change; threads may share them.)";

constexpr char kEvaluateDoc[] =
    R"(evaluate(thetas, seed=0) -> returns (N, rollouts)

Sums of rewards of thetas (N, P). Rollout r of a seed meets the same random numbers whatever the
parameters: a row's returns depend on that row, the seed and r alone, and rows are compared on equal
terms. Take another seed for fresh ones. Ctrl-C ends it.)";

constexpr char kRolloutDoc[] =
    R"(rollout(theta, seed=0) -> (states, actions, rewards)

The rollouts of theta (P,) as they go in evaluate: states (rollouts, H + 1, E), actions (rollouts, H,
A) and rewards (rollouts, H); NaN from where a rollout has diverged.)";

class PyEvaluator {
 public:
  PyEvaluator(std::shared_ptr<const MultiOutputGp> model, Task task,
              std::shared_ptr<const Policy> policy, BlockCallables callables, int rollouts,
              const EvaluatorOptions& options)
      : model_(std::move(model)),
        task_(std::move(task)),
        policy_(std::move(policy)),
        callables_(std::move(callables)),
        rollouts_(rollouts),
        options_(options),
        diverged_return_(Make(1).diverged_return()) {}  // checks

  py::array_t<double> Evaluate(py::handle thetas, py::handle seed) const {
    const Doubles parameters = ToArray(thetas, "thetas", {{"N"}, {"P", n_parameters()}});
    const auto columns = static_cast<int>(parameters.shape(1));
    if (columns == 0) throw py::value_error("thetas: shape (N, 0), must have P >= 1");
    const std::uint64_t the_seed = ToSeed(seed);
    py::array_t<double> returns({parameters.shape(0), static_cast<py::ssize_t>(rollouts_)});
    const ModelEvaluator evaluator = Make(columns);
    const std::span<const double> rows = Span(parameters);
    const std::span<double> sums = MutableSpan(&returns);
    RunInterruptibly([&](const std::atomic<bool>* stop) {
      evaluator.Evaluate(rows, columns, the_seed, sums, stop);
    });
    return returns;
  }

  py::tuple Rollout(py::handle theta, py::handle seed) const {
    const Doubles parameters = ToArray(theta, "theta", {{"P", n_parameters()}});
    if (parameters.size() == 0) throw py::value_error("theta: empty, must have P >= 1");
    const std::uint64_t the_seed = ToSeed(seed);
    const py::ssize_t lanes = rollouts_, horizon = task_.horizon;
    py::array_t<double> states({lanes, horizon + 1, py::ssize_t{task_.n_states()}});
    py::array_t<double> actions({lanes, horizon, py::ssize_t{task_.n_actions()}});
    py::array_t<double> rewards({lanes, horizon});
    const TrajectoryBuffers trajectories{MutableSpan(&states), MutableSpan(&actions),
                                         MutableSpan(&rewards)};
    const ModelEvaluator evaluator = Make(parameters.size());
    const std::span<const double> row = Span(parameters);
    RunInterruptibly([&](const std::atomic<bool>* stop) {
      evaluator.Rollout(row, the_seed, trajectories, stop);
    });
    return py::make_tuple(states, actions, rewards);
  }

  BlockCallables& callables() { return callables_; }
  // -1: whatever thetas have.
  py::ssize_t n_parameters() const {
    return callables_.policy.is_none() ? policy_->n_parameters() : -1;
  }
  const Task& task() const { return task_; }
  int rollouts() const { return rollouts_; }
  double diverged_return() const { return diverged_return_; }

 private:
  ModelEvaluator Make(py::ssize_t n_parameters) const {
    return ModelEvaluator(model_, task_, policy_,
                          MakeBlockFunctions(callables_, task_, n_parameters), rollouts_, options_);
  }

  std::shared_ptr<const MultiOutputGp> model_;
  Task task_;
  std::shared_ptr<const Policy> policy_;
  BlockCallables callables_;
  int rollouts_;
  EvaluatorOptions options_;
  double diverged_return_;
};

py::object Callable(const py::object& value, const char* name, const char* others) {
  if (value.is_none() || PyCallable_Check(value.ptr()) != 0) return value;
  throw py::type_error(std::string(name) + " = " + std::string(py::repr(value)) + ": must be " +
                       others + " or a callable");
}

std::unique_ptr<PyEvaluator> MakeEvaluator(
    py::handle gp, const py::object& task_name, const py::object& features,
    const py::object& policy, const py::object& reward, py::handle rollouts, py::handle horizon,
    py::handle start, py::handle action_limit, py::handle start_std, py::handle hidden_units,
    py::handle activation, py::handle points, py::handle use_variance, py::handle predict_noise,
    py::handle sample_clamp, py::handle preset, py::handle threads) {
  if (!py::isinstance<GaussianProcess>(gp)) {
    throw py::type_error("model = " + std::string(py::repr(gp)) + ": must be a GaussianProcess");
  }
  const auto& model = gp.cast<const GaussianProcess&>();
  const bool own_policy = PyCallable_Check(policy.ptr()) != 0;
  BlockCallables callables{py::none(), own_policy ? policy : py::none(),
                           Callable(reward, "reward", "None")};
  Task task;
  if (task_name.is_none()) {
    if (reward.is_none()) throw py::type_error("reward: must be a callable without a task");
    const bool own_features = PyCallable_Check(features.ptr()) != 0;
    if (own_features) callables.features = features;
    task =
        CustomTask(*model.model, own_features ? py::none() : features, action_limit, own_features);
  } else {
    if (!features.is_none()) throw py::value_error("features: must be None with a task");
    task = MakeTask(ToText(task_name, "task"), ToText(preset, "preset"));
  }
  SetTask(horizon, start, start_std, action_limit, &task);
  std::shared_ptr<const Policy> own;
  if (!own_policy) {
    if (std::isinf(task.action_limits.front())) {
      throw py::type_error("action_limit: must be given with a built-in policy");
    }
    own = MakePolicy(task, ToPolicyOptions(policy, hidden_units, activation, points));
  }
  EvaluatorOptions options;
  options.use_variance = ToFlag(use_variance, "use_variance");
  options.predict_noise = ToFlag(predict_noise, "predict_noise");
  options.sample_clamp = ToNumber(sample_clamp, "sample_clamp");
  if (options.sample_clamp < 0) throw py::value_error("sample_clamp: must be >= 0");
  options.threads = ToThreads(threads);
  return std::make_unique<PyEvaluator>(
      model.model, std::move(task), std::move(own), std::move(callables),
      static_cast<int>(ToInteger(rollouts, "rollouts", 1, 1000000)), options);
}

// Of the object behind `self`; null while it is being made.
BlockCallables* CallablesOf(PyObject* self) {
  void* const value = reinterpret_cast<py::detail::instance*>(self)->simple_value_holder[0];
  return value == nullptr ? nullptr : &static_cast<PyEvaluator*>(value)->callables();
}

// Lets Python's collector find cycles through callables that hold the evaluator.
void SetUpCollection(PyHeapTypeObject* heap_type) {
  PyTypeObject* const type = &heap_type->ht_type;
  type->tp_flags |= Py_TPFLAGS_HAVE_GC;
  type->tp_traverse = [](PyObject* self, visitproc visit, void* arg) {
    Py_VISIT(Py_TYPE(self));
    if (const BlockCallables* callables = CallablesOf(self)) {
      Py_VISIT(callables->features.ptr());
      Py_VISIT(callables->policy.ptr());
      Py_VISIT(callables->reward.ptr());
    }
    return 0;
  };
  type->tp_clear = [](PyObject* self) {
    if (BlockCallables* const callables = CallablesOf(self)) {
      *callables = {py::none(), py::none(), py::none()};
    }
    return 0;
  };
}

}  // namespace

void AddEvaluator(py::module_* module) {
  using py::arg;
  const py::none none;
  py::class_<PyEvaluator> type(*module, "Evaluator", kDoc, py::custom_type_setup(&SetUpCollection));
  type.def(py::init(&MakeEvaluator), arg("model"), arg("task") = none, arg("features") = none,
           arg("policy") = "nn", arg("reward") = none, arg("rollouts") = 1, arg("horizon") = none,
           arg("start") = none, arg("action_limit") = none, arg("start_std") = none,
           arg("hidden_units") = py::make_tuple(10), arg("activation") = "tanh", arg("points") = 0,
           arg("use_variance") = true, arg("predict_noise") = true, arg("sample_clamp") = 0.0,
           arg("preset") = "", arg("threads") = 2)
      .def("evaluate", &PyEvaluator::Evaluate, arg("thetas"), arg("seed") = 0, kEvaluateDoc)
      .def("rollout", &PyEvaluator::Rollout, arg("theta"), arg("seed") = 0, kRolloutDoc)
      .def_property_readonly(
          "n_parameters",
          [](const PyEvaluator& evaluator) -> py::object {
            if (evaluator.n_parameters() < 0) return py::none();
            return py::int_(evaluator.n_parameters());
          },
          "P of a built-in policy; None for a callable.")
      .def_property_readonly("rollouts", &PyEvaluator::rollouts)
      .def_property_readonly(
          "horizon", [](const PyEvaluator& evaluator) { return evaluator.task().horizon; },
          "Steps of a rollout.")
      .def_property_readonly(
          "parameter_bound",
          [](const PyEvaluator& evaluator) { return evaluator.task().parameter_bound; },
          "Parameters are searched in +- this by the learner.")
      .def_property_readonly("diverged_return", &PyEvaluator::diverged_return,
                             "Return of a rollout that has diverged, below that of any other.");
  RefuseOtherConstruction(&type, kDoc);
  RefuseOtherCalls(&type, "evaluate", kEvaluateDoc);
  RefuseOtherCalls(&type, "rollout", kRolloutDoc);
}

}  // namespace downpour::python
