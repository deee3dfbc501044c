// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "engine/search/bipop.h"
#include "engine/search/cma_es.h"

namespace downpour {

// Costs (lambda) of a whole population: `candidates` is lambda x P, row-major.
using PopulationObjective =
    std::function<void(std::span<const double> candidates, std::span<double> costs)>;

struct MinimiseOptions {
  // Every run starts at a point drawn uniformly between them (P each, lower < upper, finite).
  std::vector<double> lower, upper;
  bool bounded = false;  // whether candidates must stay there too
  double sigma = 1;      // first step size; > 0
  int population = 0;    // lambda of the first run; 0: CMA-ES's default; else >= 2
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

// Minimises a black-box function by CMA-ES with restarts, one run after the other, as published
// (RestartScheduler). Costs that are NaN count as +infinity. The result depends on the options and
// the costs alone. Throws InvalidInput for options out of range. Not for noisy costs, whose lowest
// one means little: see SearchPolicy.
MinimiseResult Minimise(const MinimiseOptions& options, const PopulationObjective& objective);

}  // namespace downpour
