// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/black_drops_step.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>

#include "engine/learner/learn_model.h"
#include "engine/learner/plan_probes.h"
#include "engine/learner/rollout_objective.h"
#include "engine/search/search_options.h"

namespace downpour {
namespace {

// Checks of the plan during a search, evenly over its budget.
constexpr int kPlanChecks = 20;

// What the search starts from: the last policy, or the origin.
std::vector<double> FirstPolicy(const LearnerState& state, const Policy& policy) {
  const EpisodeRecord* last = LastLearnt(state);
  return last == nullptr ? std::vector<double>(policy.n_parameters(), 0.0) : last->policy;
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
  RolloutObjective objective(task, policy, model->factors(), options.rollout,
                             PriorParameters(*record), callbacks.helpers);
  const int threads = objective.threads();
  std::int64_t next_check = 0;
  double waiting_seconds = 0;
  EvaluatorStatistics told;
  const auto progress = [&](const PolicySearchProgress& now) {
    waiting_seconds = now.waiting_seconds;
    if (!now.runs.empty() && now.evaluations >= next_check) {
      // Where the plans fail on what candidates meet, the search goes on with stricter ones.
      const int changed =
          model->Check(NextInputs(now.runs, task.n_inputs(), objective.evaluator()));
      if (changed > 0) objective.SetFactors(model->factors());
      record->plan_changes += changed;
      next_check = now.evaluations + options.search.evaluations / kPlanChecks + 1;
    }
    const EvaluatorStatistics statistics = objective.Statistics(waiting_seconds);
    if (callbacks.search) callbacks.search(now, statistics.Since(told));
    told = statistics;
  };
  PolicySearchOptions search = options.search;
  AdaptToStart(LastLearnt(state) != nullptr, &search);
  PolicySearchResult result = SearchPolicy(
      search, FirstPolicy(state, policy), options.seed, static_cast<std::uint32_t>(record->episode),
      [&](const CandidateBatch& batch, std::span<double> returns) {
        objective.Evaluate(batch, returns);
      },
      progress, callbacks.stop, objective.own_objectives());
  record->policy = std::move(result.parameters);
  record->predicted_return = result.predicted_return;
  record->evaluations = result.evaluations;
  record->runs = std::move(result.runs);
  const EvaluatorStatistics statistics = objective.Statistics(waiting_seconds);
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
