// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/learner_checks.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "engine/errors.h"
#include "engine/learner/text_format.h"
#include "engine/rollout/dynamics_prior.h"
#include "engine/rollout/reward.h"

namespace downpour {
namespace {

void CheckRange(const char* name, int value, int low, int high) {
  if (value >= low && value <= high) return;
  throw InvalidInput(std::string(name) + " = " + std::to_string(value) + ": must be in [" +
                     std::to_string(low) + ", " + std::to_string(high) + "]");
}

void CheckSize(const std::string& name, std::size_t size, std::size_t wanted) {
  if (size == wanted) return;
  throw InvalidInput(name + " has " + std::to_string(size) + " entries: must be " +
                     std::to_string(wanted));
}

void CheckFinite(const std::string& name, double value) {
  if (std::isfinite(value)) return;
  throw InvalidInput(name + " = " + FormatNumber(value) + ": must be finite");
}

void CheckPositive(const std::string& name, double value) {
  if (std::isfinite(value) && value > 0) return;
  throw InvalidInput(name + " = " + FormatNumber(value) + ": must be finite and > 0");
}

void CheckNotNegative(const std::string& name, double value) {
  if (std::isfinite(value) && value >= 0) return;
  throw InvalidInput(name + " = " + FormatNumber(value) + ": must be finite and >= 0");
}

void CheckTolerance(const std::string& name, double value) {
  if (value >= 0 && value <= 1) return;  // false for NaN
  throw InvalidInput(name + " = " + FormatNumber(value) + ": must be in [0, 1]");
}

void CheckEqual(const std::string& name, std::int64_t value, std::int64_t wanted) {
  if (value == wanted) return;
  throw InvalidInput(name + " = " + std::to_string(value) + ": must be " + std::to_string(wanted));
}

// `check` of every one of the `wanted` entries.
void CheckEach(const std::string& name, const std::vector<double>& values, int wanted,
               void (*check)(const std::string&, double)) {
  CheckSize(name, values.size(), static_cast<std::size_t>(wanted));
  for (std::size_t i = 0; i < values.size(); ++i) {
    check(name + "[" + std::to_string(i) + "]", values[i]);
  }
}

// Complete and H steps, or fewer and cut short.
void CheckOutcome(const std::string& name, const EpisodeRecord& record, int horizon) {
  const bool complete = record.outcome == kComplete;
  if (!complete && record.outcome != kDone && !Aborted(record)) {
    throw InvalidInput(name + ".outcome = \"" + record.outcome +
                       "\": must be complete, done or "
                       "aborted ...");
  }
  CheckRange((name + ".steps").c_str(), record.steps, complete ? horizon : 1,
             complete ? horizon : horizon - 1);
}

void CheckEpisode(const std::string& name, const EpisodeRecord& record, const Task& task,
                  const LearnerOptions& options, int n_parameters) {
  const int n_outputs = record.random ? 0 : task.n_states() + (options.learn_reward ? 1 : 0);
  CheckOutcome(name, record, task.horizon);
  CheckFinite(name + ".real_return", record.real_return);
  CheckEach(name + ".policy", record.policy, record.random ? 0 : n_parameters, CheckFinite);
  CheckSize(name + ".hyperparameters", record.hyperparameters.size(), n_outputs);
  CheckEach(name + ".jitter", record.jitter, n_outputs, CheckNotNegative);
  const bool has_prior = task.prior != nullptr && !record.random;
  CheckEqual(name + ".prior", record.prior.has_value(), has_prior);
  if (has_prior) {
    CheckEach(name + ".prior.parameters", record.prior->parameters,
              static_cast<int>(task.prior->parameters().size()), CheckFinite);
  }
  CheckSize(name + ".plans", record.plans.size(),
            options.algorithm == Algorithm::kPilco ? 0 : n_outputs);
  CheckSize(name + ".query_nanoseconds", record.query_nanoseconds.size(), record.plans.size());
  for (std::size_t e = 0; e < record.hyperparameters.size(); ++e) {
    const std::string output = name + ".hyperparameters[" + std::to_string(e) + "]";
    const Hyperparameters& parameters = record.hyperparameters[e];
    const bool is_state = static_cast<int>(e) < task.n_states();
    CheckEach(output + ".lengthscales", parameters.lengthscales,
              is_state ? task.n_inputs() : task.n_features(), CheckPositive);
    CheckPositive(output + ".signal_std", parameters.signal_std);
    CheckPositive(output + ".noise_std", parameters.noise_std);
  }
}

void CheckPrior(const std::string& prefix, const DynamicsPrior& prior) {
  for (const PriorParameter& p : prior.parameters()) {
    if (std::isfinite(p.low) && std::isfinite(p.high) && p.low < p.high && p.initial >= p.low &&
        p.initial <= p.high) {
      continue;
    }
    throw InvalidInput(prefix + "prior: " + p.name + " = " + FormatNumber(p.initial) + " in [" +
                       FormatNumber(p.low) + ", " + FormatNumber(p.high) +
                       "]: must lie in a range of finite bounds, low < high");
  }
}

void CheckTransition(const std::string& name, const Transition& transition, const Task& task) {
  CheckEach(name + ".observation", transition.observation, task.n_states(), CheckFinite);
  CheckEach(name + ".action", transition.action, task.n_actions(), CheckFinite);
  CheckEach(name + ".next_observation", transition.next_observation, task.n_states(), CheckFinite);
  CheckEach(name + ".next_state", transition.next_state, task.n_states(), CheckFinite);
  CheckFinite(name + ".reward", transition.reward);
}

}  // namespace

void CheckOptions(const LearnerOptions& options) {
  CheckRange("learn.episodes", options.episodes, 2, 1000);
  CheckRange("learn.random_episodes", options.random_episodes, 1, 999);
  if (options.random_episodes >= options.episodes) {
    throw InvalidInput("learn.random_episodes = " + std::to_string(options.random_episodes) +
                       ": must be less than learn.episodes = " + std::to_string(options.episodes));
  }
  CheckPolicyOptions(options.policy);
  CheckTolerance("model.tolerance", options.plan.variance_tolerance);
  CheckTolerance("model.mean_tolerance", options.plan.mean_tolerance);
  CheckRange("learn.threads", options.threads, 0, 1024);
  CheckRange("model.restarts", options.model.restarts, 0, 100);
  CheckRange("model.max_evaluations", options.model.max_evaluations, 1, 100000);
  CheckRange("prior.evaluations", options.prior.evaluations, 1, 10000);
  CheckNotNegative("rollout.sample_clamp", options.rollout.sample_clamp);
  CheckRange("pilco.restarts", options.pilco.restarts, 0, 1000);
  CheckRange("pilco.evaluations", options.pilco.evaluations, 1, 1000000);
  if (!(options.pilco.start_std >= 0 && options.pilco.start_std <= 1000)) {
    throw InvalidInput("pilco.start_std = " + FormatNumber(options.pilco.start_std) +
                       ": must be in [0, 1000]");
  }
}

void CheckTask(const Task& task) {
  const std::string prefix = "task " + task.name + ": ";
  const int n_states = task.n_states();
  CheckRange((prefix + "number of states").c_str(), n_states, 1, 1000);
  CheckRange((prefix + "number of features").c_str(), task.n_features(), 1, 1000);
  CheckRange((prefix + "number of actions").c_str(), task.n_actions(), 1, 1000);
  CheckRange((prefix + "horizon").c_str(), task.horizon, 1, 1000000);
  CheckSize(prefix + "feature_names", task.feature_names.size(), task.features.size());
  for (const Feature& feature : task.features) {
    CheckRange((prefix + "feature's state_index").c_str(), feature.state_index, 0, n_states - 1);
  }
  CheckEach(prefix + "action_limits", task.action_limits, task.n_actions(), CheckPositive);
  CheckEach(prefix + "start_mean", task.start_mean, n_states, CheckFinite);
  CheckEach(prefix + "start_std", task.start_std, n_states, CheckNotNegative);
  CheckEach(prefix + "observation_std", task.observation_std, n_states, CheckNotNegative);
  CheckEach(prefix + "policy_input_scale", task.policy_input_scale, task.n_features(),
            CheckPositive);
  CheckRange((prefix + "policy_points").c_str(), task.policy_points, 1, kMaxPolicyPoints);
  CheckPositive(prefix + "control_period", task.control_period);
  if (!task.reward) throw InvalidInput(prefix + "reward is empty: must be one");
  if (!task.solved) throw InvalidInput(prefix + "solved is empty: must be a function");
  if (task.prior != nullptr) CheckPrior(prefix, *task.prior);
  if (!task.make_system) throw InvalidInput(prefix + "make_system is empty: must be a function");
}

void CheckReward(const Task& task, const LearnerOptions& options) {
  if (!options.search.stop_lost_causes) return;
  if (!options.learn_reward && task.reward->InUnitInterval()) return;
  throw InvalidInput(
      "search.stop_lost_causes = true: must be false where rewards may leave [0, 1], as " +
      (options.learn_reward ? std::string("learnt ones (learn.learn_reward) may")
                            : "those of task " + task.name + " may"));
}

void CheckState(const Task& task, const LearnerOptions& options, int n_parameters,
                const LearnerState& state) {
  std::int64_t n_transitions = 0;
  for (std::size_t i = 0; i < state.episodes.size(); ++i) {
    const EpisodeRecord& record = state.episodes[i];
    const std::string name = "episodes[" + std::to_string(i) + "]";
    CheckEqual(name + ".episode", record.episode, static_cast<std::int64_t>(i) + 1);
    CheckEqual(name + ".random", record.random, record.episode <= options.random_episodes);
    CheckEpisode(name, record, task, options, n_parameters);
    n_transitions += record.steps;
  }
  CheckSize("transitions", state.transitions.size(), static_cast<std::size_t>(n_transitions));
  std::size_t i = 0;
  for (const EpisodeRecord& record : state.episodes) {
    for (int step = 0; step < record.steps; ++step, ++i) {
      const Transition& transition = state.transitions[i];
      const std::string name = "transitions[" + std::to_string(i) + "]";
      CheckEqual(name + ".episode", transition.episode, record.episode);
      CheckEqual(name + ".step", transition.step, step);
      CheckTransition(name, transition, task);
    }
  }
}

}  // namespace downpour
