// SPDX-License-Identifier: Apache-2.0
#include "engine/search/search_run.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace downpour {
namespace {

// Stopping tolerances. Returns are sums of rewards in [0, 1] over some 40 steps: a run whose
// candidates all agree to 1e-3 has nothing left to rank.
constexpr double kReturnTolerance = 1e-3;
// Standard deviation of a parameter, as a share of the bound, below which candidates are the same
// policy for all that a noisy return can tell.
constexpr double kSigmaTolerance = 1e-3;
// A principal axis this many bounds long samples the box uniformly: the run no longer searches.
constexpr double kSigmaLimit = 10;

// Cost that CMA-ES minimises. An average that is not finite is worse than any.
double Cost(std::span<const double> returns) {
  double sum = 0;
  for (const double value : returns) sum += value;
  const double mean = sum / static_cast<double>(returns.size());
  return std::isfinite(mean) ? -mean : std::numeric_limits<double>::infinity();
}

CmaEsTolerances Tolerances(double bound, double sigma) {
  CmaEsTolerances tolerances;
  tolerances.hist_fun = kReturnTolerance;
  tolerances.x = kSigmaTolerance * bound / sigma;
  tolerances.x_up = kSigmaLimit * std::max(1.0, bound / sigma);
  return tolerances;
}

std::vector<double> FromBox(const BoxTransform& box, std::vector<double> values) {
  for (double& value : values) value = box.FromBox(value);
  return values;
}

}  // namespace

SearchRun::SearchRun(const PolicySearchOptions& options, const RunPlan& plan,
                     std::vector<double> mean, std::uint64_t seed, std::uint32_t episode)
    : plan_(plan),
      uncertainty_(options.uncertainty),
      common_random_numbers_(options.common_random_numbers),
      min_rollouts_(options.rollouts),
      max_rollouts_(options.max_rollouts),
      box_(-options.bound, options.bound),
      cma_(FromBox(box_, std::move(mean)), plan.sigma, plan.population,
           {Tolerances(options.bound, plan.sigma), options.covariance,
            options.uncertainty == UncertaintyHandling::kLra}),
      measure_(plan.population),
      seed_(seed),
      episode_(episode),
      rollouts_(options.rollouts),
      costs_(static_cast<std::size_t>(plan.population)),
      ranking_(static_cast<std::size_t>(plan.population)) {}

std::vector<double> SearchRun::Mean() const {
  std::vector<double> mean(cma_.mean().begin(), cma_.mean().end());
  box_.ToBox(mean);
  return mean;
}

void SearchRun::Promote(int min_rollouts) {
  promoted_ = true;
  if (uncertainty_ == UncertaintyHandling::kRollouts) {
    min_rollouts = std::min(min_rollouts, max_rollouts_);
  }
  min_rollouts_ = std::max(min_rollouts_, min_rollouts);
  rollouts_ = std::max<double>(rollouts_, min_rollouts_);
}

SearchRun SearchRun::Fork(int run) const {
  SearchRun fork = *this;
  fork.plan_.run = run;
  fork.evaluations_ = 0;
  return fork;
}

std::size_t SearchRun::NextReevaluations() const {
  if (!reevaluates()) return 0;
  double draw;
  FillUniforms(DeriveKey(seed_, StreamPurpose::kReevaluation,
                         {episode_, static_cast<std::uint32_t>(plan_.run),
                          static_cast<std::uint32_t>(cma_.generation())}),
               0, &draw, 1);
  return static_cast<std::size_t>(ReevaluationCount(plan_.population, draw));
}

std::int64_t SearchRun::NextReturns() const {
  return std::lround(rollouts_) * static_cast<std::int64_t>(costs_.size() + NextReevaluations());
}

void SearchRun::Plan(SearchBatch* batch) {
  n_rollouts_ = static_cast<std::size_t>(std::lround(rollouts_));
  reevaluated_.resize(NextReevaluations());
  first_candidate_ = batch->n_candidates;
  first_return_ = batch->n_returns;
  batch->n_candidates += n_candidates();
  batch->n_returns += n_candidates() * n_rollouts_;
}

void SearchRun::FillRolloutKeys(StreamPurpose purpose, std::span<StreamKey> keys) const {
  const auto run = static_cast<std::uint32_t>(plan_.run);
  const auto generation = static_cast<std::uint32_t>(cma_.generation());
  switch (common_random_numbers_) {
    case CommonRandomNumbers::kSearch:
      std::fill(keys.begin(), keys.end(), DeriveKey(seed_, purpose, {episode_}));
      return;
    case CommonRandomNumbers::kGeneration:
      std::fill(keys.begin(), keys.end(), DeriveKey(seed_, purpose, {episode_, run, generation}));
      return;
    case CommonRandomNumbers::kOff:
      DeriveKeys(seed_, purpose, {episode_, run, generation}, keys);
  }
}

void SearchRun::Ask(SearchBatch* batch) {
  const auto run = static_cast<std::uint32_t>(plan_.run);
  const auto generation = static_cast<std::uint32_t>(cma_.generation());
  const std::size_t population = costs_.size();
  const auto dimension = static_cast<std::size_t>(cma_.dimension());
  double* const first = batch->parameters.data() + first_candidate_ * dimension;
  const std::span<double> candidates(first, population * dimension);
  cma_.Ask(DeriveKey(seed_, StreamPurpose::kSearchSampling, {episode_, run, generation}),
           candidates);
  box_.ToBox(candidates);
  std::copy_n(first, reevaluated_.size() * dimension, first + candidates.size());
  const auto keys = std::span(batch->keys).subspan(first_candidate_, n_candidates());
  FillRolloutKeys(StreamPurpose::kRollout, keys.first(population));
  FillRolloutKeys(StreamPurpose::kReevaluation, keys.subspan(population));
  std::fill_n(batch->n_rollouts.begin() + static_cast<std::ptrdiff_t>(first_candidate_),
              n_candidates(), static_cast<int>(n_rollouts_));
}

void SearchRun::Tell(const SearchBatch& batch) {
  const std::span<const double> returns(batch.returns);
  for (std::size_t k = 0; k < n_candidates(); ++k) {
    const double cost = Cost(returns.subspan(first_return_ + k * n_rollouts_, n_rollouts_));
    (k < costs_.size() ? costs_[k] : reevaluated_[k - costs_.size()]) = cost;
  }
  evaluations_ += static_cast<std::int64_t>(n_candidates() * n_rollouts_);
  if (reevaluated_.empty()) {
    cma_.Tell(costs_);
    return;
  }
  const double measure = measure_.Measure(costs_, reevaluated_, ranking_);
  for (std::size_t c = 0; c < reevaluated_.size(); ++c) {
    costs_[c] = (costs_[c] + reevaluated_[c]) / 2;
  }
  cma_.Tell(costs_, ranking_);
  if (uncertainty_ == UncertaintyHandling::kRollouts) {
    rollouts_ = AdaptedRollouts(rollouts_, measure, min_rollouts_, max_rollouts_);
  } else if (measure > 0) {
    cma_.ScaleSigma(SigmaFactor(cma_.dimension()));
  }
}

void LayOut(std::span<SearchRun* const> runs, bool grouped, SearchBatch* batch) {
  batch->n_candidates = batch->n_returns = 0;
  batch->groups.clear();
  for (SearchRun* run : runs) {
    run->Plan(batch);
    if (grouped) batch->groups.push_back(run->group());
  }
  batch->parameters.resize(batch->n_candidates *
                           static_cast<std::size_t>(runs.front()->dimension()));
  batch->keys.resize(batch->n_candidates);
  batch->n_rollouts.resize(batch->n_candidates);
  batch->first_rollout.assign(batch->n_candidates, 0);
  batch->returns.resize(batch->n_returns);
}

SearchBatch NextGeneration(std::span<const SearchRun> runs) {
  std::vector<SearchRun> copies(runs.begin(), runs.end());
  std::vector<SearchRun*> all;
  for (SearchRun& run : copies) all.push_back(&run);
  SearchBatch batch;
  LayOut(all, false, &batch);
  for (SearchRun& run : copies) run.Ask(&batch);
  return batch;
}

}  // namespace downpour
