// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/profile_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "engine/gp/compression.h"
#include "engine/learner/plan_probes.h"
#include "engine/learner/saved_policy.h"
#include "engine/rollout/reward.h"

namespace downpour {
namespace {

constexpr std::uint64_t kSeed = 0;

// The settings of the plan; a run's own are the default.
QueryPlanOptions PlanOptions(const ProfileSettings& settings, QueryPlanOptions options) {
  options.backend = settings.backend;
  if (settings.plan == "exact") options.variance_tolerance = options.mean_tolerance = 0;
  return options;
}

std::string PlanText(const OutputPlan& plan) {
  return fmt::format("{} of {} points, {}", plan.points, plan.n,
                     plan.backend() == QueryBackend::kBlas ? "OpenBLAS"
                     : plan.single_precision               ? "fp32"
                                                           : "fp64");
}

// Factors of `gps` by the settings' plan, chosen on their inputs and those that rollouts meet.
void AddFactors(std::vector<ExactGp> gps, const ProfileSettings& settings,
                const QueryPlanOptions& options, const PolicySearchOptions& search,
                const std::vector<double>& policy, ProfileModel* model) {
  if (settings.precision == "single") {
    for (const ExactGp& gp : gps) {
      model->factors.push_back(PackPosterior<float>(gp, ExactPosterior(gp)));
      model->plans.push_back(fmt::format("{0} of {0} points, fp32", model->points));
    }
    return;
  }
  const Eigen::MatrixXd inputs = gps.front().inputs();
  PlannedModel planned(std::move(gps), PlanOptions(settings, options), model->rollout.threads);
  Evaluator evaluator(*model->task, *model->policy, planned.exact_factors(), model->rollout,
                      model->prior);
  const Eigen::MatrixXd met =
      ProbeInputs(search, policy, kSeed, 0, model->task->n_inputs(), &evaluator);
  Eigen::MatrixXd probes(inputs.rows() + met.rows(), met.cols());
  probes << inputs, met;
  planned.Choose(std::move(probes));
  model->factors.assign(planned.factors().begin(), planned.factors().end());
  for (const OutputPlan& plan : planned.plans()) model->plans.push_back(PlanText(plan));
}

// One rollout each of `lanes` candidates, drawn by `draw(key, parameters)`.
template <typename Draw>
KeptBatch MakeBatch(int lanes, int n_parameters, const Draw& draw) {
  KeptBatch batch;
  batch.parameters.resize(static_cast<std::size_t>(lanes) * n_parameters);
  batch.n_rollouts.assign(lanes, 1);
  batch.first_rollout.assign(lanes, 0);
  for (int c = 0; c < lanes; ++c) {
    const auto index = static_cast<std::uint32_t>(c);
    batch.keys.push_back(DeriveKey(kSeed, StreamPurpose::kPlanProbe, {0, index, 2}));
    draw(DeriveKey(kSeed, StreamPurpose::kPlanProbe, {0, index, 3}),
         std::span(batch.parameters)
             .subspan(static_cast<std::size_t>(c) * n_parameters, n_parameters));
  }
  return batch;
}

// Inputs: states and actions uniform in [-1, 1]; targets: a damped, coupled motion with noise.
Dataset SyntheticData(const Task& task, int n) {
  const int n_states = task.n_states();
  Dataset data{Eigen::MatrixXd(n, task.n_inputs()), Eigen::MatrixXd(n, n_states)};
  std::vector<double> numbers(n_states + 1), noise(n_states), features(task.n_features());
  for (int i = 0; i < n; ++i) {
    const StreamKey key =
        DeriveKey(kSeed, StreamPurpose::kPlanProbe, {1, static_cast<std::uint32_t>(i)});
    FillUniforms(key, 0, numbers.data(), numbers.size());
    FillNormals(key, 1, noise.data(), noise.size());
    for (double& number : numbers) number = 2 * number - 1;
    const double action = numbers.back();
    ComputeFeatures(task, std::span(numbers).first(n_states), features);
    for (int f = 0; f < task.n_features(); ++f) data.inputs(i, f) = features[f];
    data.inputs(i, task.n_features()) = action;
    for (int e = 0; e < n_states; ++e) {
      data.targets(i, e) = -0.2 * numbers[e] + 0.2 * std::sin(3 * numbers[(e + 1) % n_states]) +
                           0.1 * action + 0.01 * noise[e];
    }
  }
  return data;
}

}  // namespace

Task SyntheticTask(int n_inputs, int n_outputs) {
  Task task;
  task.name = "synthetic";
  for (int e = 0; e < n_outputs; ++e) task.states.push_back({fmt::format("x{}", e), "1"});
  constexpr FeatureKind kKinds[] = {FeatureKind::kIdentity, FeatureKind::kCosine,
                                    FeatureKind::kSine};
  for (int f = 0; f < n_inputs - 1; ++f) {
    task.features.push_back({kKinds[f / n_outputs % 3], f % n_outputs});
    task.feature_names.push_back({fmt::format("f{}", f), "1"});
  }
  task.actions = {{"u", "1"}};
  task.action_limits = {1};
  task.start_mean.assign(n_outputs, 0.0);
  task.start_std.assign(n_outputs, 0.3);
  task.observation_std.assign(n_outputs, 0.0);
  task.policy_input_scale.assign(task.n_features(), 1.0);
  std::vector<double> first(task.n_features(), 0.0);
  first[0] = 1;
  task.reward = MakeSaturatingReward(task.feature_names, first, {0.5}, 0.25);
  return task;
}

ProfileModel SyntheticModel(const Task& task, int n, const ProfileSettings& settings) {
  ProfileModel model{.points = n, .task = &task};
  model.policy = MakePolicy(task, {.kind = settings.policy});
  const Dataset data = SyntheticData(task, n);
  const Hyperparameters hyperparameters{std::vector<double>(task.n_inputs(), 1.5), 0.5, 0.01};
  std::vector<ExactGp> gps;
  for (int e = 0; e < task.n_states(); ++e) {
    gps.emplace_back(data.inputs, data.targets.col(e), hyperparameters);
  }
  const PolicySearchOptions search;
  const std::vector<double> origin(model.policy->n_parameters(), 0.0);
  AddFactors(std::move(gps), settings, {}, search, origin, &model);
  model.batch =
      MakeBatch(settings.lanes, model.policy->n_parameters(),
                [&](StreamKey key, std::span<double> row) { DrawRandomPolicy(search, key, row); });
  return model;
}

ProfileModel LearntModel(const Task& task, const LearnerOptions& options, const LearnerState& state,
                         const EpisodeRecord& record, std::unique_ptr<Policy> policy,
                         const ProfileSettings& settings) {
  ProfileModel model{.episode = record.episode, .points = record.points, .task = &task};
  model.policy = std::move(policy);
  model.rollout = options.rollout;
  model.rollout.threads = 1;
  if (record.prior) model.prior = record.prior->parameters;
  AddFactors(EpisodeModel(task, state.transitions, record), settings, options.plan, options.search,
             record.policy, &model);
  model.batch = MakeBatch(settings.lanes, model.policy->n_parameters(),
                          [&](StreamKey key, std::span<double> row) {
                            std::copy(record.policy.begin(), record.policy.end(), row.begin());
                            PerturbPolicy(options.search, key, row);
                          });
  return model;
}

ProfileModel SavedModel(const ReadRun& run, const EpisodeRecord& record,
                        const ProfileSettings& settings) {
  const Task& task = run.resolved.task;
  const SavedPolicy saved = ReadPolicy(run.path / fmt::format("policy_{}.json", record.episode));
  return LearntModel(task, run.resolved.config.learner, run.state, record, MakePolicy(saved, task),
                     settings);
}

}  // namespace downpour
