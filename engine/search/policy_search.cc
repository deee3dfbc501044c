// SPDX-License-Identifier: Apache-2.0
#include "engine/search/policy_search.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <utility>

#include "engine/errors.h"
#include "engine/search/bipop.h"
#include "engine/search/bounds.h"
#include "engine/search/cma_es.h"
#include "engine/search/final_comparison.h"
#include "engine/search/search_options.h"
#include "engine/search/uncertainty.h"

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

// A run needs some hundred generations to learn its covariance matrix: neither so many runs at
// once nor so large a population that the budget holds fewer.
constexpr int kMinGenerations = 100;
// Most runs end in a poor local optimum, and which ones shows long before they have converged. So
// when all runs have used the exploration share of the budget, the best half of the slots goes on
// for one half of the rest, and the best quarter for the other (successive halving). The last ones
// are close to an optimum, where noise hides what is left to gain: they take more rollouts.
constexpr int kLastRollouts = 2;
constexpr int kPromotions = 2;
// Fresh rollouts that compare the runs between these stages.
constexpr int kPromotionRollouts = 48;
// The final comparison takes at most this share of the budget (and 48 rollouts a run).
constexpr int kComparisonShare = 5;

// Cost that CMA-ES minimises. An average that is not finite is worse than any.
double Cost(std::span<const double> returns) {
  double sum = 0;
  for (const double value : returns) sum += value;
  const double mean = sum / static_cast<double>(returns.size());
  return std::isfinite(mean) ? -mean : std::numeric_limits<double>::infinity();
}

// One CMA-ES run under way.
struct Instance {
  Instance(const RunPlan& run_plan, CmaEs search, int initial_rollouts)
      : plan(run_plan),
        cma(std::move(search)),
        measure(plan.population),
        rollouts(initial_rollouts),
        costs(static_cast<std::size_t>(plan.population)),
        ranking(static_cast<std::size_t>(plan.population)) {}

  RunPlan plan;
  CmaEs cma;
  UncertaintyMeasure measure;
  double rollouts;  // a candidate, before rounding
  std::int64_t evaluations = 0;
  // This generation: its part of the batch, and costs.
  int n_rollouts = 0;
  int n_reevaluated = 0;
  std::size_t first_candidate = 0;
  std::size_t first_return = 0;
  std::vector<double> costs, reevaluated;
  std::vector<int> ranking;

  std::size_t n_candidates() const {
    return static_cast<std::size_t>(plan.population) + static_cast<std::size_t>(n_reevaluated);
  }
  std::size_t n_returns() const { return n_candidates() * static_cast<std::size_t>(n_rollouts); }
};

struct FinishedRun {
  RunRecord record;
  std::vector<double> mean;  // (P) within the bounds
  Instance instance;
  // More generations may still improve it: others have converged or broken down.
  bool can_go_on() const { return record.stop == "budget" || record.stop == "Stagnation"; }
};

class PolicySearch {
 public:
  PolicySearch(const PolicySearchOptions& options, std::span<const double> start,
               std::uint64_t seed, std::uint32_t episode, const BatchObjective& objective,
               const std::atomic<bool>* stop);

  // One generation of every instance; false, nothing done, if `share` of the budget has no room for
  // it or no run is left.
  bool RunGeneration(double share);
  // Ends all runs and goes on with the best `n_runs`.
  void Promote(int n_runs, int rollouts);
  PolicySearchResult Finish();
  int n_slots() const { return n_slots_; }
  PolicySearchProgress Progress() const;

 private:
  void StartRun(Instance* slot);
  std::int64_t ComparisonReserve() const;
  void PlanGeneration();
  void Ask(Instance& instance);
  void Tell(Instance& instance);
  void SummariseGeneration();
  void EndStoppedRuns();
  void EndRun(Instance instance, std::string stop);
  void EndAllRuns();

  PolicySearchOptions options_;
  std::size_t dimension_;
  std::uint64_t seed_;
  std::uint32_t episode_;
  const BatchObjective& objective_;
  const std::atomic<bool>* stop_;
  BoxTransform box_;
  std::vector<double> start_;  // within the bounds
  int population_;
  int final_rollouts_, promotion_rollouts_;
  RestartScheduler scheduler_;
  std::vector<Instance> instances_;
  std::vector<FinishedRun> finished_;
  int n_slots_;  // instances side by side while exploring
  int promotions_ = 0;
  int runs_started_ = 0;
  std::int64_t evaluations_ = 0;
  double best_return_ = 0, mean_return_ = 0;
  // The batch.
  std::vector<double> parameters_, returns_;
  std::vector<StreamKey> keys_;
  std::vector<int> n_rollouts_, first_rollout_;
};

int Population(const PolicySearchOptions& options, std::size_t dimension) {
  // Twice the default: under noise, more candidates average better (DESIGN 5).
  return options.population > 0 ? options.population
                                : 2 * CmaEs::DefaultPopulation(static_cast<int>(dimension));
}

// Candidates a run may have for the budget to hold kMinGenerations generations of it.
std::int64_t AffordableCandidates(const PolicySearchOptions& options) {
  return options.evaluations / (std::int64_t{kMinGenerations} * options.rollouts);
}

PolicySearch::PolicySearch(const PolicySearchOptions& options, std::span<const double> start,
                           std::uint64_t seed, std::uint32_t episode,
                           const BatchObjective& objective, const std::atomic<bool>* stop)
    : options_(options),
      dimension_(start.size()),
      seed_(seed),
      episode_(episode),
      objective_(objective),
      stop_(stop),
      box_(-options.bound, options.bound),
      start_(start.begin(), start.end()),
      population_(Population(options, start.size())),
      final_rollouts_(static_cast<int>(std::clamp<std::int64_t>(
          options.evaluations / (kComparisonShare * kFinalists), 1, options.final_rollouts))),
      promotion_rollouts_(std::min(kPromotionRollouts, final_rollouts_)),
      scheduler_(options.restarts, population_,
                 static_cast<int>(std::min<std::int64_t>(AffordableCandidates(options),
                                                         std::numeric_limits<int>::max())),
                 options.restart_sigma, options.restart_decades) {
  for (double& value : start_) value = std::clamp(value, -options.bound, options.bound);
  n_slots_ = static_cast<int>(
      std::clamp<std::int64_t>(AffordableCandidates(options) / population_, 1, options.concurrent));
  instances_.reserve(static_cast<std::size_t>(n_slots_));
  for (int i = 0; i < n_slots_; ++i) StartRun(nullptr);
}

// Starts the next run in `slot`, or in a new one if null.
void PolicySearch::StartRun(Instance* slot) {
  const StreamKey key = DeriveKey(seed_, StreamPurpose::kSearchRestart,
                                  {episode_, static_cast<std::uint32_t>(runs_started_)});
  std::vector<double> mean = start_;
  RunPlan plan;
  if (runs_started_ == 0) {
    plan = scheduler_.First(options_.first_sigma);
  } else {
    double draws[2];
    FillUniforms(key, 0, draws, 2);
    plan = scheduler_.Next(draws[0], draws[1]);
    // The start is as far from zero as the run will look: sigma U[-1, 1] a parameter (DESIGN 5).
    FillUniforms(key, 1, mean.data(), mean.size());
    for (double& value : mean) {
      value = std::clamp(plan.sigma * (2 * value - 1), -options_.bound, options_.bound);
    }
  }
  for (double& value : mean) value = box_.FromBox(value);
  CmaEsTolerances tolerances;
  tolerances.hist_fun = kReturnTolerance;
  tolerances.x = kSigmaTolerance * options_.bound / plan.sigma;
  tolerances.x_up = kSigmaLimit * std::max(1.0, options_.bound / plan.sigma);
  Instance instance(plan, CmaEs(mean, plan.sigma, plan.population, tolerances), options_.rollouts);
  if (slot != nullptr) {
    *slot = std::move(instance);
  } else {
    instances_.push_back(std::move(instance));
  }
  ++runs_started_;
}

// Lays out the batch of the next generation.
void PolicySearch::PlanGeneration() {
  std::size_t n_candidates = 0, n_returns = 0;
  for (Instance& instance : instances_) {
    instance.n_rollouts = static_cast<int>(std::lround(instance.rollouts));
    if (options_.uncertainty != UncertaintyHandling::kOff) {
      double draw;
      FillUniforms(DeriveKey(seed_, StreamPurpose::kReevaluation,
                             {episode_, static_cast<std::uint32_t>(instance.plan.run),
                              static_cast<std::uint32_t>(instance.cma.generation())}),
                   0, &draw, 1);
      instance.n_reevaluated = ReevaluationCount(instance.plan.population, draw);
    }
    instance.reevaluated.resize(static_cast<std::size_t>(instance.n_reevaluated));
    instance.first_candidate = n_candidates;
    instance.first_return = n_returns;
    n_candidates += instance.n_candidates();
    n_returns += instance.n_returns();
  }
  parameters_.resize(n_candidates * dimension_);
  keys_.resize(n_candidates);
  n_rollouts_.resize(n_candidates);
  first_rollout_.assign(n_candidates, 0);
  returns_.resize(n_returns);
}

// Writes the instance's part of the batch: its population, then the first candidates again with
// other streams.
void PolicySearch::Ask(Instance& instance) {
  const auto run = static_cast<std::uint32_t>(instance.plan.run);
  const auto generation = static_cast<std::uint32_t>(instance.cma.generation());
  const auto population = static_cast<std::size_t>(instance.plan.population);
  double* const first = parameters_.data() + instance.first_candidate * dimension_;
  const std::span<double> candidates(first, population * dimension_);
  instance.cma.Ask(DeriveKey(seed_, StreamPurpose::kSearchSampling, {episode_, run, generation}),
                   candidates);
  for (double& value : candidates) value = box_.ToBox(value);
  std::copy_n(first, static_cast<std::size_t>(instance.n_reevaluated) * dimension_,
              first + candidates.size());
  for (std::size_t k = 0; k < instance.n_candidates(); ++k) {
    const bool again = k >= population;
    keys_[instance.first_candidate + k] = DeriveKey(
        seed_, again ? StreamPurpose::kReevaluation : StreamPurpose::kRollout,
        {episode_, run, generation, static_cast<std::uint32_t>(again ? k - population : k)});
    n_rollouts_[instance.first_candidate + k] = instance.n_rollouts;
  }
}

void PolicySearch::Tell(Instance& instance) {
  const auto population = static_cast<std::size_t>(instance.plan.population);
  const auto n = static_cast<std::size_t>(instance.n_rollouts);
  for (std::size_t k = 0; k < instance.n_candidates(); ++k) {
    const double cost = Cost({returns_.data() + instance.first_return + k * n, n});
    (k < population ? instance.costs[k] : instance.reevaluated[k - population]) = cost;
  }
  instance.evaluations += static_cast<std::int64_t>(instance.n_returns());
  if (instance.n_reevaluated == 0) {
    instance.cma.Tell(instance.costs);
    return;
  }
  const double measure =
      instance.measure.Measure(instance.costs, instance.reevaluated, instance.ranking);
  for (std::size_t c = 0; c < instance.reevaluated.size(); ++c) {
    instance.costs[c] = (instance.costs[c] + instance.reevaluated[c]) / 2;
  }
  instance.cma.Tell(instance.costs, instance.ranking);
  if (options_.uncertainty == UncertaintyHandling::kRollouts) {
    instance.rollouts =
        AdaptedRollouts(instance.rollouts, measure, options_.rollouts, options_.max_rollouts);
  } else if (measure > 0) {
    instance.cma.ScaleSigma(SigmaFactor(static_cast<int>(dimension_)));
  }
}

// What the comparisons that are still to come may cost at most: the start and every run so far take
// part in the final one.
std::int64_t PolicySearch::ComparisonReserve() const {
  const std::int64_t promotions = options_.exploration < 1 ? kPromotions - promotions_ : 0;
  return FinalComparisonCost(runs_started_ + 1, final_rollouts_) +
         promotions * FinalComparisonCost(runs_started_, promotion_rollouts_);
}

bool PolicySearch::RunGeneration(double share) {
  if (stop_ != nullptr && stop_->load()) throw Interrupted();
  if (instances_.empty()) return false;
  PlanGeneration();
  const auto batch_size = static_cast<std::int64_t>(returns_.size());
  const std::int64_t reserve = ComparisonReserve();
  const double available = static_cast<double>(options_.evaluations - reserve);
  if (static_cast<double>(evaluations_ + batch_size) > share * available) {
    if (evaluations_ > 0) return false;
    const double needed = static_cast<double>(reserve) + static_cast<double>(batch_size) / share;
    throw InvalidInput("search.evaluations = " + std::to_string(options_.evaluations) +
                       ": allowed at least " +
                       std::to_string(static_cast<std::int64_t>(std::ceil(needed))) +
                       ", one generation and the final comparison");
  }
  for (Instance& instance : instances_) Ask(instance);
  objective_({static_cast<int>(keys_.size()), parameters_, keys_, n_rollouts_, first_rollout_},
             returns_);
  for (Instance& instance : instances_) Tell(instance);
  evaluations_ += batch_size;
  SummariseGeneration();
  for (const Instance& instance : instances_) {
    scheduler_.Add(instance.plan, static_cast<std::int64_t>(instance.n_returns()));
  }
  EndStoppedRuns();
  return true;
}

// Runs that met a stopping criterion make room for new ones, while exploring.
void PolicySearch::EndStoppedRuns() {
  const bool exploring = promotions_ == 0;
  for (std::size_t i = 0; i < instances_.size();) {
    Instance& instance = instances_[i];
    std::string stop(instance.cma.stop());
    if (exploring && stop.empty() && scheduler_.IsExhausted(instance.plan, instance.evaluations)) {
      stop = "SmallBudget";
    }
    // A promoted run was among the best: it keeps its share although its progress is slow.
    if (stop.empty() || (!exploring && stop == "Stagnation")) {
      ++i;
      continue;
    }
    EndRun(std::move(instance), std::move(stop));
    if (exploring) {
      StartRun(&instance);
      ++i;
    } else {
      instances_.erase(instances_.begin() + static_cast<std::ptrdiff_t>(i));
    }
  }
}

void PolicySearch::SummariseGeneration() {
  double best = -std::numeric_limits<double>::infinity(), sum = 0;
  std::size_t n = 0;
  for (const Instance& instance : instances_) {
    for (const double cost : instance.costs) {
      best = std::max(best, -cost);
      sum -= cost;
      ++n;
    }
  }
  best_return_ = best;
  mean_return_ = sum / static_cast<double>(n);
}

void PolicySearch::EndRun(Instance instance, std::string stop) {
  scheduler_.End(instance.plan);
  if (instance.evaluations == 0) return;  // started as the budget ended
  RunRecord record{instance.plan.run,
                   instance.plan.regime == Regime::kLarge,
                   instance.plan.population,
                   instance.plan.sigma,
                   instance.evaluations,
                   std::move(stop),
                   0};
  std::vector<double> mean;
  for (const double value : instance.cma.mean()) mean.push_back(box_.ToBox(value));
  finished_.push_back({std::move(record), std::move(mean), std::move(instance)});
}

void PolicySearch::EndAllRuns() {
  for (Instance& instance : instances_) EndRun(std::move(instance), "budget");
  instances_.clear();
  std::sort(finished_.begin(), finished_.end(),
            [](const FinishedRun& a, const FinishedRun& b) { return a.record.run < b.record.run; });
}

void PolicySearch::Promote(int n_runs, int rollouts) {
  EndAllRuns();
  ++promotions_;
  const auto open = std::stable_partition(finished_.begin(), finished_.end(),
                                          [](const FinishedRun& run) { return !run.can_go_on(); });
  const int n_open = static_cast<int>(finished_.end() - open);
  if (n_open == 0) return;
  std::vector<double> candidates;
  for (auto run = open; run != finished_.end(); ++run) {
    candidates.insert(candidates.end(), run->mean.begin(), run->mean.end());
  }
  const FinalComparison comparison =
      CompareFinalMeans(candidates, n_open, promotion_rollouts_,
                        DeriveKey(seed_, StreamPurpose::kFinalEvaluation,
                                  {episode_, static_cast<std::uint32_t>(promotions_)}),
                        objective_, stop_);
  evaluations_ += comparison.evaluations;
  for (int k = 0; k < n_open; ++k) {
    open[k].record.mean_return = comparison.mean_returns[static_cast<std::size_t>(k)];
  }
  std::stable_sort(open, finished_.end(), [](const FinishedRun& a, const FinishedRun& b) {
    return a.record.mean_return > b.record.mean_return;
  });
  const auto end = open + std::min(n_runs, n_open);
  for (auto run = open; run != end; ++run) {
    instances_.push_back(std::move(run->instance));
    instances_.back().rollouts = rollouts;
  }
  finished_.erase(open, end);
}

PolicySearchResult PolicySearch::Finish() {
  EndAllRuns();
  std::vector<double> candidates = start_;
  for (const FinishedRun& run : finished_) {
    candidates.insert(candidates.end(), run.mean.begin(), run.mean.end());
  }
  const FinalComparison comparison = CompareFinalMeans(
      candidates, static_cast<int>(finished_.size()) + 1, final_rollouts_,
      DeriveKey(seed_, StreamPurpose::kFinalEvaluation, {episode_}), objective_, stop_);
  PolicySearchResult result;
  const auto best = static_cast<std::size_t>(comparison.best);
  result.parameters.assign(
      candidates.begin() + static_cast<std::ptrdiff_t>(best * dimension_),
      candidates.begin() + static_cast<std::ptrdiff_t>((best + 1) * dimension_));
  result.predicted_return = comparison.mean_returns[best];
  evaluations_ += comparison.evaluations;
  result.evaluations = evaluations_;
  best_return_ = mean_return_ = result.predicted_return;
  for (std::size_t k = 0; k < finished_.size(); ++k) {
    result.runs.push_back(std::move(finished_[k].record));
    result.runs.back().mean_return = comparison.mean_returns[k + 1];
  }
  return result;
}

PolicySearchProgress PolicySearch::Progress() const {
  return {evaluations_, options_.evaluations, runs_started_, best_return_, mean_return_};
}

}  // namespace

PolicySearchResult SearchPolicy(const PolicySearchOptions& options, std::span<const double> start,
                                std::uint64_t seed, std::uint32_t episode,
                                const BatchObjective& objective,
                                const std::function<void(const PolicySearchProgress&)>& progress,
                                const std::atomic<bool>* stop) {
  CheckPolicySearchOptions(options, start);
  PolicySearch search(options, start, seed, episode, objective, stop);
  const auto run_until = [&](double share) {
    while (search.RunGeneration(share)) {
      if (progress) progress(search.Progress());
    }
  };
  run_until(options.exploration);
  if (options.exploration < 1) {
    search.Promote(std::max(1, search.n_slots() / 2), options.rollouts);
    run_until((1 + options.exploration) / 2);
    search.Promote(std::max(1, search.n_slots() / 4), kLastRollouts * options.rollouts);
    run_until(1);
  }
  PolicySearchResult result = search.Finish();
  if (progress) progress(search.Progress());
  return result;
}

}  // namespace downpour
