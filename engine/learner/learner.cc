// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/learner.h"

#include <omp.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <iterator>
#include <limits>
#include <span>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/black_drops_step.h"
#include "engine/learner/execute.h"
#include "engine/learner/learn_model.h"
#include "engine/learner/learner_checks.h"
#include "engine/learner/pilco_step.h"
#include "engine/learner/planned_model.h"
#include "engine/learner/platform.h"
#include "engine/search/search_options.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Says which phase begins; the last chance to stop before it.
void BeginPhase(const Learner::Callbacks& callbacks, const char* phase) {
  if (callbacks.stop != nullptr && *callbacks.stop) throw Interrupted();
  if (callbacks.phase) callbacks.phase(phase);
}

// Actions uniform in the limits (random) or of the record's policy.
Controller MakeController(const Task& task, const Policy& policy, const EpisodeRecord& record,
                          std::uint64_t seed) {
  if (!record.random) {
    return
        [&policy, &record](int step, std::span<const double> features, std::span<double> action) {
          policy.Act(step, record.policy, features, action);
        };
  }
  const StreamKey key =
      DeriveKey(seed, StreamPurpose::kRandomEpisode, {static_cast<std::uint32_t>(record.episode)});
  return [&task, key](int step, std::span<const double>, std::span<double> action) {
    FillUniforms(key, static_cast<std::uint32_t>(step), action.data(), action.size());
    for (std::size_t i = 0; i < action.size(); ++i) {
      action[i] = task.action_limits[i] * (2 * action[i] - 1);
    }
  };
}

}  // namespace

bool Aborted(const EpisodeRecord& record) { return record.outcome.starts_with(kAborted); }

std::vector<Variable> ModelOutputs(const Task& task, const LearnerOptions& options) {
  std::vector<Variable> outputs = task.states;
  if (options.learn_reward) outputs.push_back({"reward", "1"});
  return outputs;
}

double RolloutNanosecondsPerQuery(const EpisodeRecord& record) {
  if (record.gp_queries == 0) return std::numeric_limits<double>::quiet_NaN();
  return 1e9 * record.rollout_seconds / static_cast<double>(record.gp_queries);
}

Learner::Learner(Task task, LearnerOptions options, LearnerState state)
    : task_(std::move(task)), options_(std::move(options)), state_(std::move(state)) {
  CheckOptions(options_);
  CheckTask(task_);
  CheckReward(task_, options_);
  options_.rollout.threads = options_.threads == 0 ? omp_get_num_procs() : options_.threads;
  options_.search.threads = options_.rollout.threads;
  policy_ = MakePolicy(task_, options_.policy);
  const std::vector<double> origin(policy_->n_parameters(), 0.0);
  CheckPolicySearchOptions(options_.search, origin);
  if (options_.algorithm == Algorithm::kPilco) {
    CheckPilco(task_, options_);
  } else {
    CheckSearchBudget(options_.search, origin, options_.seed, options_.random_episodes + 1);
  }
  CheckState(task_, options_, policy_->n_parameters(), state_);
  if (!done()) system_ = task_.make_system();
}

bool Learner::done() const {
  if (static_cast<int>(state_.episodes.size()) >= options_.episodes) return true;
  return options_.until_solved && std::any_of(state_.episodes.begin(), state_.episodes.end(),
                                              [](const EpisodeRecord& e) { return e.solved; });
}

void Learner::LearnPolicy(const Callbacks& callbacks, EpisodeRecord* record) const {
  BeginPhase(callbacks, "model");
  auto start = std::chrono::steady_clock::now();
  std::vector<ExactGp> gps = LearnModel(task_, options_, state_, callbacks.stop, record);
  std::optional<PlannedModel> model;
  if (options_.algorithm == Algorithm::kBlackDrops) {
    model.emplace(PlanQueries(task_, options_, state_, *policy_, std::move(gps), *record));
  }
  record->model_seconds = SecondsSince(start);
  BeginPhase(callbacks, "search");
  start = std::chrono::steady_clock::now();
  if (model) {
    SearchByRollouts(task_, options_, state_, *policy_, callbacks, &*model, record);
  } else {
    SearchByMomentMatching(task_, options_, state_, callbacks, gps, record);
  }
  record->search_seconds = SecondsSince(start);
}

const EpisodeRecord& Learner::RunEpisode(const Callbacks& callbacks) {
  EpisodeRecord record;
  record.episode = static_cast<int>(state_.episodes.size()) + 1;
  record.random = record.episode <= options_.random_episodes;
  record.predicted_return = record.lane_fill = record.idle_share =
      std::numeric_limits<double>::quiet_NaN();
  record.platform = CurrentPlatform();
  if (!record.random) LearnPolicy(callbacks, &record);
  BeginPhase(callbacks, "execute");
  if (system_ == nullptr) system_ = task_.make_system();
  const std::uint32_t episode = static_cast<std::uint32_t>(record.episode);
  Execution execution =
      ExecuteEpisode(task_, *system_, record.episode,
                     DeriveKey(options_.seed, StreamPurpose::kStartState, {episode}),
                     DeriveKey(options_.seed, StreamPurpose::kObservationNoise, {episode}),
                     MakeController(task_, *policy_, record, options_.seed));
  record.real_return = execution.real_return;
  record.solved = execution.solved;
  record.outcome = std::move(execution.outcome);
  record.steps = static_cast<int>(execution.transitions.size());
  record.interaction_seconds =
      static_cast<double>(state_.transitions.size() + execution.transitions.size()) *
      task_.control_period;
  // Room first: nothing below throws with half of the episode in the state.
  state_.episodes.reserve(state_.episodes.size() + 1);
  state_.transitions.reserve(state_.transitions.size() + execution.transitions.size());
  std::move(execution.transitions.begin(), execution.transitions.end(),
            std::back_inserter(state_.transitions));
  state_.episodes.push_back(std::move(record));
  return state_.episodes.back();
}

}  // namespace downpour
