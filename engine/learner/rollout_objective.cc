// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/rollout_objective.h"

#include <algorithm>
#include <variant>

namespace downpour {
namespace {

void EvaluateBatch(const CandidateBatch& batch, Evaluator* evaluator, std::span<double> returns) {
  evaluator->Evaluate(batch.parameters, batch.keys, batch.n_rollouts, batch.first_rollout, returns,
                      batch.groups, batch.relaxed);
}

bool AnyForBlas(std::span<const QueryFactor> factors) {
  return std::any_of(factors.begin(), factors.end(), [](const QueryFactor& factor) {
    return std::holds_alternative<BlasFactor>(factor);
  });
}

}  // namespace

RolloutObjective::RolloutObjective(const Task& task, const Policy& policy,
                                   std::span<const QueryFactor> factors,
                                   const EvaluatorOptions& options, std::span<const double> prior,
                                   RolloutHelpers* helpers)
    : helpers_(helpers),
      prior_(prior.begin(), prior.end()),
      threads_(helpers == nullptr ? options.threads : helpers->threads()),
      all_threads_(task, policy, factors, options, prior_) {
  if (helpers != nullptr) {
    helpers->SetModel(factors, prior_);
    return;
  }
  if (options.threads == 1 || AnyForBlas(factors)) return;
  EvaluatorOptions alone = options;
  alone.threads = 1;
  own_.reserve(static_cast<std::size_t>(options.threads));
  for (int thread = 0; thread < options.threads; ++thread) {
    Evaluator* evaluator = &own_.emplace_back(task, policy, factors, alone, prior_);
    own_objectives_.push_back([evaluator](const CandidateBatch& batch, std::span<double> returns) {
      EvaluateBatch(batch, evaluator, returns);
    });
  }
}

void RolloutObjective::SetFactors(std::span<const QueryFactor> factors) {
  all_threads_.SetFactors(factors);
  for (Evaluator& evaluator : own_) evaluator.SetFactors(factors);
  if (helpers_ != nullptr) helpers_->SetModel(factors, prior_);
}

void RolloutObjective::Evaluate(const CandidateBatch& batch, std::span<double> returns) {
  if (helpers_ != nullptr) return helpers_->Evaluate(batch, &all_threads_, returns);
  EvaluateBatch(batch, &all_threads_, returns);
}

EvaluatorStatistics RolloutObjective::Statistics(double waiting_seconds) const {
  EvaluatorStatistics own;
  for (const Evaluator& evaluator : own_) own += evaluator.statistics();
  own.seconds = (own.seconds + waiting_seconds) / threads_;
  own.idle_seconds += waiting_seconds;
  own += all_threads_.statistics();
  return own;
}

}  // namespace downpour
