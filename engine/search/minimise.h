// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "engine/search/bipop.h"
#include "engine/search/bounds.h"
#include "engine/search/cma_es.h"

namespace downpour {

// Costs (lambda) of a whole population: `candidates` is lambda x P, row-major.
using PopulationObjective =
    std::function<void(std::span<const double> candidates, std::span<double> costs)>;

struct MinimiseOptions {
  // Every run starts at a point drawn uniformly between them (P each, lower < upper, finite).
  std::vector<double> lower, upper;
  bool bounded = false;       // whether candidates must stay there too
  std::vector<double> start;  // (P) where the first run starts instead; empty: drawn as the others
  double sigma = 1;           // first step size; > 0
  int population = 0;         // lambda of the first run; 0: CMA-ES's default; else >= 2
  RestartStrategy restarts = RestartStrategy::kBipop;
  double restart_decades = 2;  // small runs take sigma 10^(-decades U); >= 0
  CovarianceForm covariance = CovarianceForm::kAuto;
  bool adapt_rates = false;  // LRA-CMA-ES
  CmaEsTolerances tolerances;
  double target = -std::numeric_limits<double>::infinity();  // a lower cost ends the search
  std::int64_t evaluations = 1'000'000;                      // the most that it may take; >= 1
  std::uint64_t seed = 0;
};

struct MinimiseRun {
  RunPlan plan;
  std::int64_t evaluations = 0;
  // The criterion of CmaEs::stop(), "SmallBudget" (BIPOP), "target" or "budget".
  std::string stop;
  double best_cost = std::numeric_limits<double>::infinity();
};

struct MinimiseResult {
  std::vector<double> best;  // (P) the candidate of the lowest cost
  double best_cost = std::numeric_limits<double>::infinity();
  std::int64_t evaluations = 0;  // up to the candidate that reached the target, else all
  std::vector<MinimiseRun> runs;
};

// CMA-ES with restarts, one run after the other, as published (RestartScheduler), ask and tell: for
// a loop of the caller's own. The candidates depend on the options and the costs alone. Not
// thread-safe. Not for noisy costs, whose lowest one means little: see SearchPolicy.
class Minimiser {
 public:
  // Throws InvalidInput for options out of range.
  explicit Minimiser(MinimiseOptions options);

  int dimension() const { return static_cast<int>(options_.lower.size()); }
  int population() const { return cma_->population(); }  // of the present run
  // A new population (lambda x P, row-major); the same until it is told. Not once stopped.
  std::span<const double> Ask();
  // Their costs (lambda), which end a run and begin the next as the case may be; NaN counts as
  // +infinity. Once an Ask.
  void Tell(std::span<const double> costs);
  // "target", "budget" (no room for another population) or, if no restarts are made, the criterion
  // that ended the run (CmaEs::stop); empty while the search should go on.
  std::string_view stop() const { return stop_; }
  // With the runs that have ended.
  const MinimiseResult& result() const { return result_; }
  std::int64_t generations() const { return generations_; }  // told, of all runs
  std::vector<double> mean() const;  // (P) of the present run's distribution
  double sigma() const { return cma_->sigma(); }
  int run() const { return plan_.run; }  // number of the present run, 0 the first

 private:
  StreamKey RunKey(int run) const;
  void StartRun();
  // Counts the population up to the first candidate that reaches the target; whether one does.
  bool CountCosts(std::span<const double> costs);
  // Ends runs that have stopped, and begins the next, until one can go on or the search has ended.
  void Advance();

  MinimiseOptions options_;
  RestartScheduler scheduler_;
  std::vector<BoxTransform> boxes_;  // (P), none if unbounded
  RunPlan plan_;
  std::optional<CmaEs> cma_;
  MinimiseRun run_;
  std::vector<double> candidates_;
  bool asked_ = false;
  std::int64_t generations_ = 0;
  std::string stop_;
  MinimiseResult result_;
};

// Minimises a black-box function so. Throws InvalidInput for options out of range.
MinimiseResult Minimise(const MinimiseOptions& options, const PopulationObjective& objective);

}  // namespace downpour
