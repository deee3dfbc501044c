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
#include "engine/learner/execute.h"
#include "engine/learner/learner_checks.h"
#include "engine/learner/plan_probes.h"
#include "engine/learner/planned_model.h"
#include "engine/learner/platform.h"
#include "engine/learner/prior_fit.h"
#include "engine/search/search_options.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// Candidates whose rollouts check the plan.
constexpr int kCheckedCandidates = 32;
// Checks of the plan during a search, evenly over its budget.
constexpr int kPlanChecks = 20;

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Says which phase begins; the last chance to stop before it.
void BeginPhase(const Learner::Callbacks& callbacks, const char* phase) {
  if (callbacks.stop != nullptr && *callbacks.stop) throw Interrupted();
  if (callbacks.phase) callbacks.phase(phase);
}

// The last record with a learnt policy, or nullptr.
const EpisodeRecord* LastLearnt(const LearnerState& state) {
  return state.episodes.empty() || state.episodes.back().random ? nullptr : &state.episodes.back();
}

// What the search starts from: the last policy, or the origin.
std::vector<double> FirstPolicy(const LearnerState& state, const Policy& policy) {
  const EpisodeRecord* last = LastLearnt(state);
  return last == nullptr ? std::vector<double>(policy.n_parameters(), 0.0) : last->policy;
}

// Inputs (features of the observation, action), targets next observation - observation (paper,
// section III-B; LearnPrior has others).
Dataset MakeDataset(const Task& task, std::span<const Transition> transitions) {
  Dataset data;
  const int n = static_cast<int>(transitions.size());
  data.inputs.resize(n, task.n_inputs());
  data.targets.resize(n, task.n_states());
  std::vector<double> features(task.features.size());
  for (int i = 0; i < n; ++i) {
    const Transition& transition = transitions[i];
    ComputeFeatures(task, transition.observation, features);
    for (int f = 0; f < task.n_features(); ++f) data.inputs(i, f) = features[f];
    for (int a = 0; a < task.n_actions(); ++a) {
      data.inputs(i, task.n_features() + a) = transition.action[a];
    }
    for (int e = 0; e < task.n_states(); ++e) {
      data.targets(i, e) = transition.next_observation[e] - transition.observation[e];
    }
  }
  return data;
}

// Inputs features of the next observation, one target: the reward observed (paper section IV-B).
Dataset MakeRewardDataset(const Task& task, std::span<const Transition> transitions) {
  Dataset data;
  const int n = static_cast<int>(transitions.size());
  data.inputs.resize(n, task.n_features());
  data.targets.resize(n, 1);
  std::vector<double> features(task.features.size());
  for (int i = 0; i < n; ++i) {
    ComputeFeatures(task, transitions[i].next_observation, features);
    for (int f = 0; f < task.n_features(); ++f) data.inputs(i, f) = features[f];
    data.targets(i, 0) = transitions[i].reward;
  }
  return data;
}

// Hyper-parameters of n outputs of the last model from `first_output` on; none without one.
std::vector<Hyperparameters> WarmStart(const EpisodeRecord* last, int first_output, int n) {
  if (last == nullptr) return {};
  const auto first = last->hyperparameters.begin() + first_output;
  return {first, first + n};
}

// Learns a GP for each output of `data`, which are those of the model from `first_output` on, and
// appends them to `gps` and their numbers to the record. Returns the sum of log likelihoods.
double LearnOutputs(const Dataset& data, int first_output, const LearnerOptions& options,
                    const std::vector<Hyperparameters>& warm_start, const std::atomic<bool>* stop,
                    std::vector<ExactGp>* gps, EpisodeRecord* record) {
  double log_likelihood = 0;
  const std::vector<GpFit> fits = FitHyperparameters(data, warm_start, options.model, options.seed,
                                                     static_cast<std::uint32_t>(record->episode),
                                                     options.rollout.threads, stop, first_output);
  for (int e = 0; e < data.n_outputs(); ++e) {
    record->hyperparameters.push_back(fits[e].hyperparameters);
    gps->emplace_back(data.inputs, data.targets.col(e), fits[e].hyperparameters);
    const double signal_std = fits[e].hyperparameters.signal_std;
    record->jitter.push_back(gps->back().jitter() / (signal_std * signal_std));
    log_likelihood += fits[e].log_likelihood;
  }
  return log_likelihood;
}

// The parameters of the task's prior in the record; empty without one.
std::span<const double> PriorParameters(const EpisodeRecord& record) {
  if (!record.prior) return {};
  return record.prior->parameters;
}

// Puts the residuals of the prior at these parameters in the place of the targets.
void UseResiduals(const DynamicsPrior& prior, const std::vector<double>& parameters,
                  std::span<const Transition> transitions, Dataset* data) {
  const std::unique_ptr<PriorPredictor> predictor = prior.MakePredictor();
  predictor->SetParameters(parameters);
  data->targets = PriorResiduals(transitions, predictor.get());
}

// Learns the parameters of the task's prior, puts the residuals in the place of the targets and
// returns where to start their hyper-parameters.
std::vector<Hyperparameters> LearnPrior(const Task& task, const LearnerOptions& options,
                                        const LearnerState& state, const std::atomic<bool>* stop,
                                        Dataset* data, EpisodeRecord* record) {
  PriorFit last;
  if (const EpisodeRecord* episode = LastLearnt(state)) {
    last.hyperparameters = WarmStart(episode, 0, task.n_states());
    last.parameters = episode->prior->parameters;
  }
  PriorFit fit =
      FitPrior(*task.prior, state.transitions, data->inputs, last, options,
               static_cast<std::uint32_t>(record->episode), options.rollout.threads, stop);
  UseResiduals(*task.prior, fit.parameters, state.transitions, data);
  record->prior = {.parameters = std::move(fit.parameters), .evaluations = fit.evaluations};
  return std::move(fit.hyperparameters);
}

// Learns the model of all transitions so far and plans its queries; fills the record's model
// fields.
PlannedModel LearnModel(const Task& task, const LearnerOptions& options, const LearnerState& state,
                        const Policy& policy, const std::atomic<bool>* stop,
                        EpisodeRecord* record) {
  const auto start = std::chrono::steady_clock::now();
  Dataset data = MakeDataset(task, state.transitions);
  const EpisodeRecord* last = LastLearnt(state);
  std::vector<Hyperparameters> warm_start =
      task.prior ? LearnPrior(task, options, state, stop, &data, record)
                 : WarmStart(last, 0, task.n_states());
  std::vector<ExactGp> gps;
  const double likelihood = LearnOutputs(data, 0, options, warm_start, stop, &gps, record);
  if (record->prior) record->prior->log_likelihood = likelihood;
  if (options.learn_reward) {
    LearnOutputs(MakeRewardDataset(task, state.transitions), task.n_states(), options,
                 WarmStart(last, task.n_states(), 1), stop, &gps, record);
  }
  PlannedModel model(std::move(gps), options.plan, options.rollout.threads);
  Evaluator evaluator(task, policy, model.exact_factors(), options.rollout,
                      PriorParameters(*record));
  const Eigen::MatrixXd met =
      ProbeInputs(options.search, FirstPolicy(state, policy), options.seed,
                  static_cast<std::uint32_t>(record->episode), task.n_inputs(), &evaluator);
  Eigen::MatrixXd probes(data.inputs.rows() + met.rows(), data.inputs.cols());
  probes << data.inputs, met;
  model.Choose(std::move(probes));
  record->points = data.n_points();
  record->model_seconds = SecondsSince(start);
  return model;
}

// Checks the plans on inputs that a sample of the batch's candidates meets, and goes on with
// stricter ones where they fail.
void CheckPlans(const Task& task, const CandidateBatch& batch, int n_parameters,
                RolloutHelpers* helpers, Evaluator* evaluator, PlannedModel* model,
                EpisodeRecord* record) {
  std::vector<double> parameters;
  std::vector<StreamKey> keys;
  const int every = std::max(1, batch.n_candidates / kCheckedCandidates);
  for (int c = 0; c < batch.n_candidates; c += every) {
    const auto row = batch.parameters.subspan(static_cast<std::size_t>(c) * n_parameters,
                                              static_cast<std::size_t>(n_parameters));
    parameters.insert(parameters.end(), row.begin(), row.end());
    keys.push_back(batch.keys[c]);
  }
  const int changed = model->Check(MetInputs(evaluator, parameters, keys, task.n_inputs()));
  if (changed > 0) {
    evaluator->SetFactors(model->factors());
    if (helpers != nullptr) helpers->SetModel(model->factors(), PriorParameters(*record));
  }
  record->plan_changes += changed;
}

// Searches from the last policy, or from the origin, and fills the record's search fields.
void LearnPolicy(const Task& task, const LearnerOptions& options, const LearnerState& state,
                 const Policy& policy, const Learner::Callbacks& callbacks, PlannedModel* model,
                 EpisodeRecord* record) {
  const auto start = std::chrono::steady_clock::now();
  Evaluator evaluator(task, policy, model->factors(), options.rollout, PriorParameters(*record));
  RolloutHelpers* const helpers = callbacks.helpers;
  if (helpers != nullptr) helpers->SetModel(model->factors(), PriorParameters(*record));
  const int threads = helpers == nullptr ? options.rollout.threads : helpers->threads();
  std::int64_t next_check = 0;
  EvaluatorStatistics told;
  const auto progress = [&](const PolicySearchProgress& search) {
    if (callbacks.search) callbacks.search(search, evaluator.statistics().Since(told));
    told = evaluator.statistics();
  };
  const BatchObjective objective = [&](const CandidateBatch& batch, std::span<double> returns) {
    if (evaluator.statistics().rollouts >= next_check) {
      CheckPlans(task, batch, policy.n_parameters(), helpers, &evaluator, model, record);
      next_check += options.search.evaluations / kPlanChecks + 1;
    }
    if (helpers != nullptr) return helpers->Evaluate(batch, &evaluator, returns);
    evaluator.Evaluate(batch.parameters, batch.keys, batch.n_rollouts, batch.first_rollout, returns,
                       batch.groups);
  };
  PolicySearchOptions search = options.search;
  if (LastLearnt(state) == nullptr) search.local_share = 0;  // there is no last policy
  PolicySearchResult result = SearchPolicy(search, FirstPolicy(state, policy), options.seed,
                                           static_cast<std::uint32_t>(record->episode), objective,
                                           progress, callbacks.stop);
  record->policy = std::move(result.parameters);
  record->predicted_return = result.predicted_return;
  record->evaluations = result.evaluations;
  record->runs = std::move(result.runs);
  const EvaluatorStatistics& statistics = evaluator.statistics();
  record->gp_queries = statistics.gp_queries;
  record->diverged = statistics.diverged;
  record->lane_fill = statistics.LaneFill();
  record->idle_share = statistics.IdleShare(threads);
  for (std::size_t e = 0; e < model->plans().size(); ++e) {
    const OutputPlan& plan = model->plans()[e];
    record->plans.push_back({plan.backend(), plan.points, plan.single_precision, plan.tau,
                             plan.relative_cost, model->errors()[e].variance,
                             model->errors()[e].mean});
  }
  record->rollout_seconds = statistics.seconds;
  if (record->prior) {
    record->prior->step_nanoseconds =
        1e9 * statistics.prior_seconds / static_cast<double>(statistics.steps);
    record->prior->search_share = statistics.prior_seconds / (threads * statistics.seconds);
  }
  record->query_nanoseconds = model->TimeQueries(record->prior.has_value());
  record->search_seconds = SecondsSince(start);
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
  if (record.random) return std::numeric_limits<double>::quiet_NaN();
  return 1e9 * record.rollout_seconds / static_cast<double>(record.gp_queries);
}

std::vector<ExactGp> EpisodeModel(const Task& task, const std::vector<Transition>& transitions,
                                  const EpisodeRecord& record) {
  const auto end = std::find_if(transitions.begin(), transitions.end(),
                                [&](const Transition& t) { return t.episode >= record.episode; });
  const std::span<const Transition> earlier(transitions.begin(), end);
  Dataset data = MakeDataset(task, earlier);
  if (record.prior) UseResiduals(*task.prior, record.prior->parameters, earlier, &data);
  std::vector<ExactGp> gps;
  for (int e = 0; e < data.n_outputs(); ++e) {
    gps.emplace_back(data.inputs, data.targets.col(e), record.hyperparameters[e]);
  }
  if (record.hyperparameters.size() > gps.size()) {  // the reward was learnt, too
    const Dataset rewards = MakeRewardDataset(task, earlier);
    gps.emplace_back(rewards.inputs, rewards.targets.col(0), record.hyperparameters.back());
  }
  return gps;
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
  CheckSearchBudget(options_.search, origin, options_.seed, options_.random_episodes + 1);
  CheckState(task_, options_, policy_->n_parameters(), state_);
  if (!done()) system_ = task_.make_system();
}

bool Learner::done() const {
  if (static_cast<int>(state_.episodes.size()) >= options_.episodes) return true;
  return options_.until_solved && std::any_of(state_.episodes.begin(), state_.episodes.end(),
                                              [](const EpisodeRecord& e) { return e.solved; });
}

const EpisodeRecord& Learner::RunEpisode(const Callbacks& callbacks) {
  EpisodeRecord record;
  record.episode = static_cast<int>(state_.episodes.size()) + 1;
  record.random = record.episode <= options_.random_episodes;
  record.predicted_return = record.lane_fill = record.idle_share =
      std::numeric_limits<double>::quiet_NaN();
  record.platform = CurrentPlatform();
  if (!record.random) {
    BeginPhase(callbacks, "model");
    PlannedModel model = LearnModel(task_, options_, state_, *policy_, callbacks.stop, &record);
    BeginPhase(callbacks, "search");
    LearnPolicy(task_, options_, state_, *policy_, callbacks, &model, &record);
  }
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
