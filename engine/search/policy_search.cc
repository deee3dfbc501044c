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
#include "engine/search/cma_es.h"
#include "engine/search/final_comparison.h"
#include "engine/search/search_options.h"
#include "engine/search/search_run.h"

namespace downpour {
namespace {

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

struct FinishedRun {
  RunRecord record;
  std::vector<double> mean;  // (P) within the bounds
  SearchRun run;
  // More generations may still improve it: others have converged or broken down.
  bool can_go_on() const { return record.stop == "budget" || record.stop == "Stagnation"; }
};

class PolicySearch {
 public:
  PolicySearch(const PolicySearchOptions& options, std::span<const double> start,
               std::uint64_t seed, std::uint32_t episode, const BatchObjective& objective,
               const std::atomic<bool>* stop);

  // One generation of every run; false, nothing done, if `share` of the budget has no room for
  // it or no run is left.
  bool RunGeneration(double share);
  // Ends all runs and goes on with the best `n_runs`.
  void Promote(int n_runs, int rollouts);
  PolicySearchResult Finish();
  int n_slots() const { return n_slots_; }
  PolicySearchProgress Progress() const;

 private:
  void StartRun(SearchRun* slot);
  std::int64_t ComparisonReserve() const;
  void PlanGeneration();
  void SummariseGeneration();
  void EndStoppedRuns();
  void EndRun(SearchRun run, std::string stop);
  void EndAllRuns();

  PolicySearchOptions options_;
  std::size_t dimension_;
  std::uint64_t seed_;
  std::uint32_t episode_;
  const BatchObjective& objective_;
  const std::atomic<bool>* stop_;
  std::vector<double> start_;  // within the bounds
  int population_;
  int final_rollouts_, promotion_rollouts_;
  RestartScheduler scheduler_;
  std::vector<SearchRun> runs_;
  std::vector<FinishedRun> finished_;
  int n_slots_;  // instances side by side while exploring
  int promotions_ = 0;
  int runs_started_ = 0;
  std::int64_t evaluations_ = 0;
  double best_return_ = 0, mean_return_ = 0;
  SearchBatch batch_;
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
  runs_.reserve(static_cast<std::size_t>(n_slots_));
  for (int i = 0; i < n_slots_; ++i) StartRun(nullptr);
}

// Starts the next run in `slot`, or in a new one if null.
void PolicySearch::StartRun(SearchRun* slot) {
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
  SearchRun run(options_, plan, std::move(mean), seed_, episode_);
  if (slot != nullptr) {
    *slot = std::move(run);
  } else {
    runs_.push_back(std::move(run));
  }
  ++runs_started_;
}

// Lays out the batch of the next generation.
void PolicySearch::PlanGeneration() {
  batch_.n_candidates = batch_.n_returns = 0;
  for (SearchRun& run : runs_) run.Plan(&batch_);
  batch_.parameters.resize(batch_.n_candidates * dimension_);
  batch_.keys.resize(batch_.n_candidates);
  batch_.n_rollouts.resize(batch_.n_candidates);
  batch_.first_rollout.assign(batch_.n_candidates, 0);
  batch_.returns.resize(batch_.n_returns);
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
  if (runs_.empty()) return false;
  PlanGeneration();
  const auto batch_size = static_cast<std::int64_t>(batch_.n_returns);
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
  const auto n_runs = static_cast<std::ptrdiff_t>(runs_.size());
#pragma omp parallel for schedule(dynamic) num_threads(options_.threads)
  for (std::ptrdiff_t i = 0; i < n_runs; ++i) runs_[static_cast<std::size_t>(i)].Ask(&batch_);
  objective_({static_cast<int>(batch_.n_candidates), batch_.parameters, batch_.keys,
              batch_.n_rollouts, batch_.first_rollout},
             batch_.returns);
#pragma omp parallel for schedule(dynamic) num_threads(options_.threads)
  for (std::ptrdiff_t i = 0; i < n_runs; ++i) runs_[static_cast<std::size_t>(i)].Tell(batch_);
  evaluations_ += batch_size;
  SummariseGeneration();
  for (const SearchRun& run : runs_) scheduler_.Add(run.plan(), run.n_returns());
  EndStoppedRuns();
  return true;
}

// Runs that met a stopping criterion make room for new ones, while exploring.
void PolicySearch::EndStoppedRuns() {
  const bool exploring = promotions_ == 0;
  for (std::size_t i = 0; i < runs_.size();) {
    SearchRun& run = runs_[i];
    std::string stop(run.stop());
    if (exploring && stop.empty() && scheduler_.IsExhausted(run.plan(), run.evaluations())) {
      stop = "SmallBudget";
    }
    // A promoted run was among the best: it keeps its share although its progress is slow.
    if (stop.empty() || (!exploring && stop == "Stagnation")) {
      ++i;
      continue;
    }
    EndRun(std::move(run), std::move(stop));
    if (exploring) {
      StartRun(&run);
      ++i;
    } else {
      runs_.erase(runs_.begin() + static_cast<std::ptrdiff_t>(i));
    }
  }
}

void PolicySearch::SummariseGeneration() {
  double best = -std::numeric_limits<double>::infinity(), sum = 0;
  std::size_t n = 0;
  for (const SearchRun& run : runs_) {
    for (const double cost : run.costs()) {
      best = std::max(best, -cost);
      sum -= cost;
      ++n;
    }
  }
  best_return_ = best;
  mean_return_ = sum / static_cast<double>(n);
}

void PolicySearch::EndRun(SearchRun run, std::string stop) {
  scheduler_.End(run.plan());
  if (run.evaluations() == 0) return;  // started as the budget ended
  RunRecord record{run.plan().run,
                   run.plan().regime == Regime::kLarge,
                   run.plan().population,
                   run.plan().sigma,
                   run.evaluations(),
                   std::move(stop),
                   0};
  std::vector<double> mean = run.Mean();
  finished_.push_back({std::move(record), std::move(mean), std::move(run)});
}

void PolicySearch::EndAllRuns() {
  for (SearchRun& run : runs_) EndRun(std::move(run), "budget");
  runs_.clear();
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
    runs_.push_back(std::move(run->run));
    runs_.back().set_rollouts(rollouts);
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
