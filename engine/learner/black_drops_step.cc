// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/black_drops_step.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>

#include "engine/learner/learn_model.h"
#include "engine/learner/plan_probes.h"

namespace downpour {
namespace {

// Candidates whose rollouts check the plan.
constexpr int kCheckedCandidates = 32;
// Checks of the plan during a search, evenly over its budget.
constexpr int kPlanChecks = 20;

// What the search starts from: the last policy, or the origin.
std::vector<double> FirstPolicy(const LearnerState& state, const Policy& policy) {
  const EpisodeRecord* last = LastLearnt(state);
  return last == nullptr ? std::vector<double>(policy.n_parameters(), 0.0) : last->policy;
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

}  // namespace

PlannedModel PlanQueries(const Task& task, const LearnerOptions& options, const LearnerState& state,
                         const Policy& policy, std::vector<ExactGp> gps,
                         const EpisodeRecord& record) {
  const Eigen::MatrixXd inputs = gps.front().inputs();
  PlannedModel model(std::move(gps), options.plan, options.rollout.threads);
  Evaluator evaluator(task, policy, model.exact_factors(), options.rollout,
                      PriorParameters(record));
  const Eigen::MatrixXd met =
      ProbeInputs(options.search, FirstPolicy(state, policy), options.seed,
                  static_cast<std::uint32_t>(record.episode), task.n_inputs(), &evaluator);
  Eigen::MatrixXd probes(inputs.rows() + met.rows(), inputs.cols());
  probes << inputs, met;
  model.Choose(std::move(probes));
  return model;
}

void SearchByRollouts(const Task& task, const LearnerOptions& options, const LearnerState& state,
                      const Policy& policy, const Learner::Callbacks& callbacks,
                      PlannedModel* model, EpisodeRecord* record) {
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
}

}  // namespace downpour
