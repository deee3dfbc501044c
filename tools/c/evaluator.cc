// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/evaluator.h"

#include <algorithm>
#include <cstddef>
#include <limits>
#include <memory>
#include <string>
#include <utility>

#include "engine/rollout/model_evaluator.h"
#include "engine/rollout/policy.h"
#include "tasks/registry.h"
#include "tools/c/downpour.h"
#include "tools/c/handles.h"
#include "tools/c/status.h"

struct downpour_evaluator {
  downpour::ModelEvaluator evaluator;
};

namespace downpour::c {
namespace {

// The state differences of E states whose features they are themselves, and A = D - E actions.
Task PlainTask(const MultiOutputGp& model, const downpour_evaluator_options& options) {
  RequireSet(reinterpret_cast<const void*>(options.reward_function),
             "options.reward_function, without a task");
  RequireSet(options.start, "options.start, without a task");
  RequireRange("options.horizon, without a task", options.horizon, 1, 1e6);
  const int n_states = model.n_outputs(), n_actions = model.n_inputs() - n_states;
  if (n_actions < 1) {
    throw InvalidInput("gp: " + std::to_string(model.n_inputs()) + " inputs and " +
                       std::to_string(n_states) +
                       " outputs: without a task, inputs must be the states and 1 action at least");
  }
  Task task;
  task.name = "custom";
  for (int e = 0; e < n_states; ++e) {
    task.states.push_back({"state" + std::to_string(e), ""});
    task.features.push_back({FeatureKind::kIdentity, e});
  }
  task.feature_names = task.states;
  for (int a = 0; a < n_actions; ++a) task.actions.push_back({"action" + std::to_string(a), ""});
  task.action_limits.assign(n_actions, std::numeric_limits<double>::infinity());
  task.start_std.assign(n_states, 0);
  task.observation_std.assign(n_states, 0);
  task.policy_input_scale.assign(n_states, 1);
  return task;
}

// What the options say beside the task.
void Override(const downpour_evaluator_options& options, Task* task) {
  const auto set = [](const double* from, int n, const char* name, double low, double high,
                      std::vector<double>* to) {
    if (from == nullptr) return;
    to->assign(from, from + n);
    for (const double x : *to) RequireRange(name, x, low, high);
  };
  const double limit = Evaluator::kStateLimit, huge = std::numeric_limits<double>::max();
  set(options.start, task->n_states(), "options.start", -limit, limit, &task->start_mean);
  set(options.start_std, task->n_states(), "options.start_std", 0, limit, &task->start_std);
  set(options.action_limits, task->n_actions(), "options.action_limits",
      std::numeric_limits<double>::min(), huge, &task->action_limits);
  RequireRange("options.horizon", options.horizon, 0, 1e6);
  if (options.horizon > 0) task->horizon = options.horizon;
}

std::shared_ptr<const Policy> ToPolicy(const downpour_evaluator_options& options,
                                       const Task& task) {
  PolicyOptions policy;
  const std::string kind = options.policy == nullptr ? "nn" : options.policy;
  const auto found = std::find(kPolicyKindNames.begin(), kPolicyKindNames.end(), kind);
  if (found == kPolicyKindNames.end()) {
    throw InvalidInput("options.policy = \"" + kind + "\": must be nn, linear, gp or dmp");
  }
  if (task.action_limits.front() == std::numeric_limits<double>::infinity()) {
    throw InvalidInput("options.action_limits: NULL, must be given with a built-in policy");
  }
  policy.kind = static_cast<PolicyKind>(found - kPolicyKindNames.begin());
  policy.hidden_units = {options.hidden_units};
  policy.points = options.policy_points;
  return MakePolicy(task, policy);
}

void RequireZero(int returned, const char* function, int step) {
  if (returned == 0) return;
  throw CallbackFailed(std::string(function) + ": returned " + std::to_string(returned) +
                       " at step " + std::to_string(step));
}

// Both kinds of callback read two blocks and write one; null gives none.
BlockPolicy ToFunction(downpour_policy_function function, void* user_data, const char* name) {
  if (function == nullptr) return nullptr;
  return [function, user_data, name](int step, int lanes, const double* first, const double* second,
                                     double* result) {
    RequireZero(function(user_data, step, lanes, first, second, result), name, step);
  };
}

std::unique_ptr<downpour_evaluator> Make(const downpour_gp& gp,
                                         const downpour_evaluator_options& options) {
  Task task = options.task == nullptr
                  ? PlainTask(*gp.model, options)
                  : MakeTask(options.task, options.preset == nullptr ? "" : options.preset);
  Override(options, &task);
  std::shared_ptr<const Policy> policy;
  if (options.policy_function == nullptr) policy = ToPolicy(options, task);
  RequireRange("options.sample_clamp", options.sample_clamp, 0, std::numeric_limits<double>::max());
  RequireRange("options.rollouts", options.rollouts, 1, 1e6);
  const EvaluatorOptions evaluator{options.use_variance != 0, options.predict_noise != 0,
                                   options.sample_clamp, Threads(options.threads)};
  BlockPolicy act = ToFunction(options.policy_function, options.user_data, "policy_function");
  BlockReward reward = ToFunction(options.reward_function, options.user_data, "reward_function");
  return std::unique_ptr<downpour_evaluator>(new downpour_evaluator{
      ModelEvaluator(gp.model, std::move(task), std::move(policy),
                     {{}, std::move(act), std::move(reward)}, options.rollouts, evaluator)});
}

const ModelEvaluator& Get(const downpour_evaluator* evaluator) {
  RequireSet(evaluator, "evaluator");
  return evaluator->evaluator;
}

std::span<const double> Parameters(const double* parameters, std::int64_t n, int n_parameters) {
  RequireRange("n", static_cast<double>(n), 0, 1e9);
  RequireRange("n_parameters", n_parameters, 1, 1e9);
  const std::span<const double> numbers =
      Numbers(parameters, static_cast<std::size_t>(n) * n_parameters, "parameters");
  RequireFinite(numbers, "parameters");
  return numbers;
}

}  // namespace
}  // namespace downpour::c

using namespace downpour;     // NOLINT: the functions are C's
using namespace downpour::c;  // NOLINT

int downpour_evaluator_options_init(downpour_evaluator_options* options) {
  return InitOptions(options, [](downpour_evaluator_options& to) {
    to.hidden_units = 10;
    to.rollouts = 1;
    to.threads = 1;
    to.use_variance = 1;
    to.predict_noise = 1;
  });
}

int downpour_evaluator_create(const downpour_gp* gp, const downpour_evaluator_options* options,
                              downpour_evaluator** evaluator) {
  return Guard([&] {
    RequireSet(gp, "gp");
    RequireSet(evaluator, "evaluator");
    RequireSize(options, "options");
    *evaluator = Make(*gp, *options).release();
  });
}

void downpour_evaluator_destroy(downpour_evaluator* evaluator) { delete evaluator; }

int downpour_evaluator_sizes(const downpour_evaluator* evaluator, downpour_evaluator_size* sizes) {
  return Guard([&] {
    const ModelEvaluator& of = Get(evaluator);
    RequireSize(sizes, "sizes");
    const Task& task = of.task();
    *sizes = {sizeof *sizes,
              task.n_states(),
              task.n_features(),
              task.n_actions(),
              task.horizon,
              of.rollouts(),
              of.policy() == nullptr ? 0 : of.policy()->n_parameters(),
              task.parameter_bound,
              of.diverged_return()};
  });
}

int downpour_evaluator_evaluate(const downpour_evaluator* evaluator, const double* parameters,
                                int64_t n, int n_parameters, uint64_t seed, double* returns) {
  return Guard([&] {
    const ModelEvaluator& of = Get(evaluator);
    const std::span<const double> rows = Parameters(parameters, n, n_parameters);
    of.Evaluate(rows, n_parameters, seed,
                Room(returns, static_cast<std::size_t>(n) * of.rollouts(), "returns"));
  });
}

int downpour_evaluator_rollout(const downpour_evaluator* evaluator, const double* parameters,
                               int n_parameters, uint64_t seed, double* states, double* actions,
                               double* rewards) {
  return Guard([&] {
    const ModelEvaluator& of = Get(evaluator);
    const std::span<const double> row = Parameters(parameters, 1, n_parameters);
    const Task& task = of.task();
    const std::size_t rollouts = of.rollouts(), horizon = task.horizon;
    of.Rollout(row, seed,
               {Room(states, rollouts * (horizon + 1) * task.n_states(), "states"),
                Room(actions, rollouts * horizon * task.n_actions(), "actions"),
                Room(rewards, rollouts * horizon, "rewards")});
  });
}
