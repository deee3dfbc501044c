// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/learn_model.h"

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>

#include "engine/learner/prior_fit.h"

namespace downpour {
namespace {

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

}  // namespace

const EpisodeRecord* LastLearnt(const LearnerState& state) {
  return state.episodes.empty() || state.episodes.back().random ? nullptr : &state.episodes.back();
}

std::span<const double> PriorParameters(const EpisodeRecord& record) {
  if (!record.prior) return {};
  return record.prior->parameters;
}

std::vector<ExactGp> LearnModel(const Task& task, const LearnerOptions& options,
                                const LearnerState& state, const std::atomic<bool>* stop,
                                EpisodeRecord* record) {
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
  record->points = data.n_points();
  return gps;
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

}  // namespace downpour
