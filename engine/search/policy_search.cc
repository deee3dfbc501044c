// SPDX-License-Identifier: Apache-2.0
#include "engine/search/policy_search.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "engine/errors.h"
#include "engine/parallel_for.h"
#include "engine/search/bipop.h"
#include "engine/search/cma_es.h"
#include "engine/search/final_comparison.h"
#include "engine/search/run_queue.h"
#include "engine/search/search_options.h"
#include "engine/search/search_run.h"

namespace downpour {
namespace {

// A run needs some hundred generations to learn its covariance matrix: neither so many runs at
// once nor so large a population that the budget holds fewer.
constexpr int kMinGenerations = 100;
// All runs are looked at together, and threads that have runs of their own wait for each other,
// between rounds. A round has at most so many generations, and a search that explores alike all
// along about so many rounds, if its budget holds more generations.
constexpr int kMaxRoundGenerations = 32;
constexpr int kRounds = 64;
// Most runs end in a poor local optimum, and which ones shows long before they have converged. So
// when all runs have used the exploration share of the budget, the best half of the slots goes on,
// then the best half of these (successive halving). What goes on is ever closer to an optimum,
// where noise hides what is left to gain: half as many runs take twice the rollouts a candidate,
// and fill as many lanes. The last ones take at least:
constexpr int kLastRollouts = 2;
// One run alone would leave threads to share each of its batches and to wait for each other every
// time. So the last one goes on twice, with random numbers of its own each time.
constexpr int kLastRuns = 2;
// Fresh rollouts that compare the runs between these stages.
constexpr int kPromotionRollouts = 48;
// The final comparison and the estimate of its winner take at most this share of the budget (and
// 48 rollouts a run).
constexpr int kComparisonShare = 5;
// Streams of kFinalEvaluation: 0 for the final comparison, 1, 2, ... for the promotions.
constexpr std::uint32_t kWinnerEvaluation = 0xFFFFFFFF;

// Whether restart `number` (>= 1) is one of the local ones, which are spread evenly (over all
// numbers, a few of which forks have).
bool IsLocal(double share, int number) {
  return std::floor(share * number) > std::floor(share * (number - 1));
}

struct FinishedRun {
  RunRecord record;
  std::vector<double> mean;  // (P) within the bounds
  SearchRun run;
  bool open;  // more generations may still improve it: others have converged or broken down
};

class PolicySearch {
 public:
  PolicySearch(const PolicySearchOptions& options, std::span<const double> start,
               std::uint64_t seed, std::uint32_t episode, const BatchObjective& objective,
               std::span<const BatchObjective> own_objectives, const std::atomic<bool>* stop);

  // How many generations the next round has; 0 if `share` of the budget has no room for one. Throws
  // InvalidInput if it is the first one.
  int PlanRound(double share) const;
  // A round of generations of every run, of each until it meets a stopping criterion; false,
  // nothing done, if `share` of the budget has no room for one.
  bool RunRound(double share);
  // Ends all runs and goes on with the best `n_runs` and so many forks of the best, each with at
  // least so many rollouts.
  void Promote(int n_runs, int forks, int rollouts);
  PolicySearchResult Finish();
  int n_slots() const { return n_slots_; }
  // Whether generations are relaxed now: those of exploration, if stages follow it.
  bool relaxed() const {
    return options_.relaxed_exploration && options_.restarts != RestartStrategy::kSingle &&
           options_.exploration < 1 && promotions_ == 0;
  }
  PolicySearchProgress Progress() const;

 private:
  SearchRun NewRun();
  std::optional<SearchRun> NextRun();
  std::int64_t ComparisonReserve() const;
  // All threads take the runs of the queue through their generations together, or each takes some
  // of them, until RunQueue gives no shares any more.
  void RunTogether(RunQueue* queue);
  void RunApart(RunQueue* queue);
  void RunGeneration(std::span<SearchRun* const> runs, int threads, const BatchObjective& objective,
                     SearchBatch* batch) const;
  void SummariseGeneration();
  void EndStoppedRuns();
  void EndRun(SearchRun run, std::string stop);
  void EndAllRuns();
  void CompareOpenRuns();
  FinalComparison Compare(std::span<const double> candidates, int n, int rollouts,
                          std::uint32_t comparison);

  PolicySearchOptions options_;
  std::size_t dimension_;
  std::uint64_t seed_;
  std::uint32_t episode_;
  const BatchObjective& objective_;
  std::span<const BatchObjective> own_objectives_;
  const std::atomic<bool>* stop_;
  std::vector<double> start_;  // within the bounds
  int population_;
  int final_rollouts_, promotion_rollouts_;
  int n_slots_;  // instances side by side while exploring
  int round_generations_;
  RestartScheduler scheduler_;
  std::vector<SearchRun> runs_;
  std::vector<FinishedRun> finished_;
  int promotions_ = 0;
  int promoted_rollouts_ = 0;  // least rollouts a candidate of a promoted run
  std::int64_t evaluations_ = 0;
  double best_return_ = 0, mean_return_ = 0, waiting_seconds_ = 0;
  SearchBatch batch_;
  std::vector<SearchBatch> own_batches_;  // of each thread with an objective of its own
};

double Population(const PolicySearchOptions& options, std::size_t dimension) {
  return options.population > 0 ? options.population
                                : CmaEs::DefaultPopulation(static_cast<int>(dimension));
}

// Candidates of all runs together for which the budget holds kMinGenerations generations.
std::int64_t AffordableCandidates(const PolicySearchOptions& options) {
  return options.evaluations / (std::int64_t{kMinGenerations} * options.rollouts);
}

PolicySearch::PolicySearch(const PolicySearchOptions& options, std::span<const double> start,
                           std::uint64_t seed, std::uint32_t episode,
                           const BatchObjective& objective,
                           std::span<const BatchObjective> own_objectives,
                           const std::atomic<bool>* stop)
    : options_(options),
      dimension_(start.size()),
      seed_(seed),
      episode_(episode),
      objective_(objective),
      own_objectives_(own_objectives),
      stop_(stop),
      start_(start.begin(), start.end()),
      population_(static_cast<int>(Population(options, start.size()))),
      final_rollouts_(static_cast<int>(std::clamp<std::int64_t>(
          options.evaluations / (kComparisonShare * (kFinalists + 1)), 1, options.final_rollouts))),
      promotion_rollouts_(std::min(kPromotionRollouts, final_rollouts_)),
      n_slots_(static_cast<int>(std::clamp<std::int64_t>(
          AffordableCandidates(options) / population_, 1,
          options.restarts == RestartStrategy::kSingle ? 1 : options.concurrent))),
      round_generations_(static_cast<int>(std::clamp<std::int64_t>(
          options.evaluations / options.rollouts / (std::int64_t{population_} * n_slots_ * kRounds),
          1, kMaxRoundGenerations))),
      scheduler_(options.restarts, Population(options, start.size()),
                 static_cast<int>(std::min<std::int64_t>(AffordableCandidates(options) / n_slots_,
                                                         std::numeric_limits<int>::max())),
                 options.restart_sigma, options.restart_decades),
      own_batches_(own_objectives.size()) {
  for (double& value : start_) value = std::clamp(value, -options.bound, options.bound);
  runs_.reserve(static_cast<std::size_t>(n_slots_));
  for (int i = 0; i < n_slots_; ++i) runs_.push_back(NewRun());
}

SearchRun PolicySearch::NewRun() {
  const int number = scheduler_.runs_started();
  const StreamKey key = DeriveKey(seed_, StreamPurpose::kSearchRestart,
                                  {episode_, static_cast<std::uint32_t>(number)});
  std::vector<double> mean = start_;
  RunPlan plan;
  if (number == 0) {
    plan = scheduler_.First(options_.first_sigma);
  } else {
    double draws[2];
    FillUniforms(key, 0, draws, 2);
    plan = scheduler_.Next(draws[0], draws[1]);
    if (IsLocal(options_.local_share, number)) {
      plan.sigma = options_.first_sigma;
    } else {
      // The start is as far from zero as the run will look: sigma U[-1, 1] a parameter.
      FillUniforms(key, 1, mean.data(), mean.size());
      for (double& value : mean) {
        value = std::clamp(plan.sigma * (2 * value - 1), -options_.bound, options_.bound);
      }
    }
  }
  return SearchRun(options_, plan, std::move(mean), seed_, episode_);
}

// What takes a free slot: while exploring a new run, later the best open one that has not gone on
// yet, if any is left. Nothing if there are no restarts.
std::optional<SearchRun> PolicySearch::NextRun() {
  auto best = finished_.end();
  for (auto run = finished_.begin(); promotions_ > 0 && run != finished_.end(); ++run) {
    if (!run->open) continue;
    if (best == finished_.end() || run->record.mean_return > best->record.mean_return) best = run;
  }
  if (best == finished_.end()) {
    return scheduler_.restarts() ? std::optional(NewRun()) : std::nullopt;
  }
  SearchRun run = std::move(best->run);
  finished_.erase(best);
  run.Promote(promoted_rollouts_);
  return run;
}

// What the comparisons that are still to come may cost at most: the start and every run so far take
// part in the final one, whose winner is evaluated again.
std::int64_t PolicySearch::ComparisonReserve() const {
  const std::int64_t promotions = options_.exploration < 1 ? options_.promotions - promotions_ : 0;
  const auto n_runs = static_cast<int>(finished_.size() + runs_.size());
  return FinalComparisonCost(n_runs + 1, final_rollouts_) + final_rollouts_ +
         promotions * FinalComparisonCost(n_runs, promotion_rollouts_);
}

int PolicySearch::PlanRound(double share) const {
  if (runs_.empty()) return 0;
  std::int64_t generation = 0;
  for (const SearchRun& run : runs_) generation += run.NextReturns();
  const std::int64_t reserve = ComparisonReserve();
  const double available = share * static_cast<double>(options_.evaluations - reserve);
  const double left = available - static_cast<double>(evaluations_);
  if (static_cast<double>(generation) <= left) {
    // What re-evaluates may take more rollouts in the generation after.
    const int most = runs_.front().reevaluates() ? 1 : round_generations_;
    return static_cast<int>(std::min<double>(most, left / static_cast<double>(generation)));
  }
  if (evaluations_ > 0) return 0;
  const double needed = static_cast<double>(reserve) + static_cast<double>(generation) / share;
  throw InvalidInput(
      "search.evaluations = " + std::to_string(options_.evaluations) + ": must be at least " +
      std::to_string(static_cast<std::int64_t>(std::ceil(needed))) +
      ", for one generation of search.population = " + std::to_string(population_) +
      " with search.rollouts = " + std::to_string(options_.rollouts) + " and the final comparison");
}

bool PolicySearch::RunRound(double share) {
  const int generations = PlanRound(share);
  if (generations == 0) return false;
  std::vector<std::int64_t> before;
  for (const SearchRun& run : runs_) before.push_back(run.evaluations());
  RunQueue queue(runs_, generations);
  if (own_objectives_.size() > 1 && runs_.size() >= own_objectives_.size()) RunApart(&queue);
  RunTogether(&queue);
  for (std::size_t i = 0; i < runs_.size(); ++i) {
    const std::int64_t spent = runs_[i].evaluations() - before[i];
    evaluations_ += spent;
    if (!runs_[i].promoted()) scheduler_.Add(runs_[i].plan(), spent);
  }
  SummariseGeneration();
  EndStoppedRuns();
  return true;
}

void PolicySearch::RunTogether(RunQueue* queue) {
  std::vector<SearchRun*> taken;
  while (queue->TakeAll(&taken)) {
    RunGeneration(taken, options_.threads, objective_, &batch_);
    queue->Return(taken);
  }
}

void PolicySearch::RunApart(RunQueue* queue) {
  using Clock = std::chrono::steady_clock;
  const int n_threads = static_cast<int>(own_objectives_.size());
  std::vector<Clock::duration> work_times(own_objectives_.size());
  const Clock::time_point start = Clock::now();
  const auto work = [&](int i) {
    const auto t = static_cast<std::size_t>(i);
    Clock::duration worked{};
    std::vector<SearchRun*> taken;
    try {
      while (queue->TakeShare(n_threads, &taken)) {
        const Clock::time_point begin = Clock::now();
        RunGeneration(taken, 1, own_objectives_[t], &own_batches_[t]);
        worked += Clock::now() - begin;
        queue->Return(taken);
      }
    } catch (...) {
      queue->Abandon();
      throw;
    }
    work_times[t] = worked;
  };
  ParallelFor(n_threads, n_threads, work, Assignment::kFixed);
  const Clock::duration elapsed = Clock::now() - start;
  for (const Clock::duration worked : work_times) {
    waiting_seconds_ += std::chrono::duration<double>(elapsed - worked).count();
  }
}

void PolicySearch::RunGeneration(std::span<SearchRun* const> runs, int threads,
                                 const BatchObjective& objective, SearchBatch* batch) const {
  if (stop_ != nullptr && stop_->load()) throw Interrupted();
  LayOut(runs, options_.stop_lost_causes, batch);
  batch->relaxed = relaxed();
  const int n_runs = static_cast<int>(runs.size());
  const auto ask = [&](int i) { runs[static_cast<std::size_t>(i)]->Ask(batch); };
  const auto tell = [&](int i) { runs[static_cast<std::size_t>(i)]->Tell(*batch); };
  ParallelFor(n_runs, threads, ask, Assignment::kFixed);
  objective(batch->Candidates(), batch->returns);
  ParallelFor(n_runs, threads, tell, Assignment::kFixed);
}

// Runs that met a stopping criterion make room for others.
void PolicySearch::EndStoppedRuns() {
  for (SearchRun& run : runs_) {
    std::string stop(run.stop());
    if (!run.promoted() && stop.empty() && scheduler_.IsExhausted(run.plan(), run.evaluations())) {
      stop = "SmallBudget";
    }
    if (stop.empty()) continue;
    EndRun(std::move(run), std::move(stop));
    if (std::optional<SearchRun> next = NextRun()) {
      run = *std::move(next);
    } else {
      runs_.clear();  // it was the only one
      return;
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
  if (!run.promoted()) scheduler_.End(run.plan());
  if (run.evaluations() == 0) return;  // started as the budget ended
  RunRecord record{run.plan().run,
                   run.plan().regime == Regime::kLarge,
                   run.plan().population,
                   run.plan().sigma,
                   run.evaluations(),
                   std::move(stop),
                   0};
  // What stagnates after exploration has had its chance.
  const bool open = record.stop == "budget" || (record.stop == "Stagnation" && promotions_ == 0);
  std::vector<double> mean = run.Mean();
  finished_.push_back({std::move(record), std::move(mean), std::move(run), open});
}

void PolicySearch::EndAllRuns() {
  for (SearchRun& run : runs_) EndRun(std::move(run), "budget");
  runs_.clear();
  std::sort(finished_.begin(), finished_.end(),
            [](const FinishedRun& a, const FinishedRun& b) { return a.record.run < b.record.run; });
}

// Mean returns of `n` policies by fresh rollouts on common streams.
FinalComparison PolicySearch::Compare(std::span<const double> candidates, int n, int rollouts,
                                      std::uint32_t comparison) {
  const StreamKey key = DeriveKey(seed_, StreamPurpose::kFinalEvaluation, {episode_, comparison});
  FinalComparison result = CompareFinalMeans(candidates, n, rollouts, key, objective_, stop_);
  evaluations_ += result.evaluations;
  return result;
}

void PolicySearch::CompareOpenRuns() {
  std::vector<double> candidates;
  std::vector<FinishedRun*> open;
  for (FinishedRun& run : finished_) {
    if (!run.open) continue;
    open.push_back(&run);
    candidates.insert(candidates.end(), run.mean.begin(), run.mean.end());
  }
  const FinalComparison comparison =
      Compare(candidates, static_cast<int>(open.size()), promotion_rollouts_,
              static_cast<std::uint32_t>(promotions_));
  for (std::size_t k = 0; k < open.size(); ++k) {
    open[k]->record.mean_return = comparison.mean_returns[k];
  }
}

void PolicySearch::Promote(int n_runs, int forks, int rollouts) {
  EndAllRuns();
  ++promotions_;
  promoted_rollouts_ = rollouts;
  const auto n_open = std::count_if(finished_.begin(), finished_.end(),
                                    [](const FinishedRun& run) { return run.open; });
  if (n_open > n_runs) CompareOpenRuns();
  for (int i = 0; i < n_runs; ++i) {
    if (std::optional<SearchRun> next = NextRun()) runs_.push_back(*std::move(next));
  }
  for (int i = 0; i < forks && !runs_.empty(); ++i) {
    // What is not promoted is a new run, as no other may still improve.
    runs_.push_back(runs_.front().promoted() ? runs_.front().Fork(scheduler_.TakeNumber())
                                             : NewRun());
  }
}

PolicySearchResult PolicySearch::Finish() {
  EndAllRuns();
  std::vector<double> candidates = start_;
  for (const FinishedRun& run : finished_) {
    candidates.insert(candidates.end(), run.mean.begin(), run.mean.end());
  }
  const FinalComparison comparison =
      Compare(candidates, static_cast<int>(finished_.size()) + 1, final_rollouts_, 0);
  PolicySearchResult result;
  const auto best = static_cast<std::size_t>(comparison.best);
  result.parameters.assign(
      candidates.begin() + static_cast<std::ptrdiff_t>(best * dimension_),
      candidates.begin() + static_cast<std::ptrdiff_t>((best + 1) * dimension_));
  // The comparison favours whom its rollouts flatter: the prediction takes fresh ones.
  result.predicted_return =
      Compare(result.parameters, 1, final_rollouts_, kWinnerEvaluation).mean_returns[0];
  result.evaluations = evaluations_;
  best_return_ = mean_return_ = result.predicted_return;
  for (std::size_t k = 0; k < finished_.size(); ++k) {
    result.runs.push_back(std::move(finished_[k].record));
    result.runs.back().mean_return = comparison.mean_returns[k + 1];
  }
  return result;
}

PolicySearchProgress PolicySearch::Progress() const {
  return {evaluations_,
          options_.evaluations,
          scheduler_.runs_started(),
          best_return_,
          mean_return_,
          relaxed(),
          waiting_seconds_,
          runs_};
}

}  // namespace

void CheckSearchBudget(const PolicySearchOptions& options, std::span<const double> start,
                       std::uint64_t seed, std::uint32_t episode) {
  const BatchObjective none;
  PolicySearch(options, start, seed, episode, none, {}, nullptr).PlanRound(options.exploration);
}

PolicySearchResult SearchPolicy(const PolicySearchOptions& options, std::span<const double> start,
                                std::uint64_t seed, std::uint32_t episode,
                                const BatchObjective& objective,
                                const std::function<void(const PolicySearchProgress&)>& progress,
                                const std::atomic<bool>* stop,
                                std::span<const BatchObjective> own_objectives) {
  CheckPolicySearchOptions(options, start);
  PolicySearch search(options, start, seed, episode, objective, own_objectives, stop);
  const auto run_until = [&](double share) {
    while (search.RunRound(share)) {
      if (progress) progress(search.Progress());
    }
  };
  run_until(options.exploration);
  for (int k = 1; k <= options.promotions && options.exploration < 1; ++k) {
    const bool last = k == options.promotions;
    const int n_best = std::max(1, search.n_slots() >> k);
    const int n_runs = std::max(n_best, std::min(kLastRuns, search.n_slots()));
    const int factor = std::max(last ? kLastRollouts : 1, (search.n_slots() + n_runs - 1) / n_runs);
    search.Promote(n_best, n_runs - n_best, factor * options.rollouts);
    run_until(last ? 1 : options.exploration + (1 - options.exploration) * k / options.promotions);
  }
  PolicySearchResult result = search.Finish();
  if (progress) progress(search.Progress());
  return result;
}

}  // namespace downpour
