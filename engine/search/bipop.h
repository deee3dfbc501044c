// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "engine/search/policy_search.h"

namespace downpour {

enum class Regime {
  kFirst,  // the run the search begins with; its evaluations count among the small ones
  kLarge,
  kSmall,
};

// What a CMA-ES run starts with.
struct RunPlan {
  int run = 0;  // number of the run, 0 the first
  Regime regime = Regime::kFirst;
  int population = 0;
  double sigma = 0;
};

// Decides what each restart is. kBipop is N. Hansen, "Benchmarking a BI-Population CMA-ES on the
// BBOB-2009 Function Testbed" (GECCO 2009): large runs take lambda_l = 2^i lambda_def (i = 1, 2,
// ..., 9) and sigma; small ones lambda_s = floor(lambda_def (lambda_l / (2 lambda_def))^(U^2)) and
// sigma 10^(-decades U'), at most half of the evaluations of all large runs; a small run is next
// while the small ones have used fewer evaluations than the large ones. The first run counts among
// the small ones, as in Hansen's own program (pycma). kSmall: every restart
// takes lambda_def and the sigma of a small run. kIpop is A. Auger and N. Hansen, "A Restart CMA
// Evolution Strategy With Increasing Population Size" (CEC 2005): every restart doubles lambda and
// takes sigma. kSingle: there is no run after the first.
//
// Several runs may be under way at once. What they have used so far counts, and one more
// generation of each, so that runs which start together are divided among the regimes too. With
// one run at a time this is BIPOP as published. Not thread-safe.
class RestartScheduler {
 public:
  // max_population limits lambda_l. lambda_def need not be whole: populations are rounded down
  // after doubling, as in pycma: 10.9 becomes 10, 21, 43, 87, 174, which takes 40 % fewer
  // evaluations of Rastrigin's function than 10, 20, 40, 80, 160.
  RestartScheduler(RestartStrategy strategy, double default_population, int max_population,
                   double sigma, double decades);

  // The run that the search begins with, with its own step size.
  RunPlan First(double sigma);
  // Whether there is a run after the first.
  bool restarts() const { return strategy_ != RestartStrategy::kSingle; }
  // The next run; u_population and u_sigma are the draws U and U' in [0, 1). Not of kSingle.
  RunPlan Next(double u_population, double u_sigma);

  int runs_started() const { return runs_started_; }
  // The next number, for a run that is no restart and counts in no regime.
  int TakeNumber() { return runs_started_++; }

  // `run` has used this many further evaluations.
  void Add(const RunPlan& run, std::int64_t evaluations);
  // Whether a small run that has used this many evaluations has exhausted its share. Not while a
  // large run is under way, whose evaluations still grow.
  bool IsExhausted(const RunPlan& run, std::int64_t evaluations) const;
  // `run` has ended. Once a run.
  void End(const RunPlan& run);

  // All that the future depends on beside the arguments of the constructor, as numbers.
  std::vector<double> Save() const;
  // Takes it over, exactly. Throws InvalidInput if `state` is no list that Save wrote.
  void Restore(std::span<const double> state);

 private:
  struct Usage {
    std::int64_t evaluations = 0;
    std::int64_t under_way = 0;  // sum of the populations of the runs under way
  };
  Usage& UsageOf(const RunPlan& run) { return run.regime == Regime::kLarge ? large_ : small_; }
  double DrawSmallSigma(double u) const;
  int LargePopulation() const;  // lambda_l of the newest large run
  template <typename Archive>
  void Visit(Archive& archive);

  RestartStrategy strategy_;
  double default_population_;
  int max_population_;
  double sigma_;
  double decades_;
  int runs_started_ = 0;
  int doublings_ = 0;  // i of the newest large run
  Usage large_, small_;
};

}  // namespace downpour
