// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "engine/candidate_group.h"
#include "engine/search/strategy_parameters.h"
#include "kernels/philox/philox.h"

namespace downpour {

enum class RestartStrategy {
  kBipop,   // Hansen 2009: a regime of doubling populations beside one of small ones
  kSmall,   // every restart small: lambda stays, sigma is drawn log-uniformly
  kIpop,    // Auger and Hansen 2005: every restart doubles lambda
  kSingle,  // one run, which `concurrent` does not change
};

// What to do about noise: kSigma and kRollouts when re-evaluation shows that it scrambles the
// ranking (Hansen et al. 2009).
enum class UncertaintyHandling {
  kOff,
  kSigma,     // widen the step size, as Black-DROPS does
  kRollouts,  // raise the number of rollouts a candidate
  // Nothing is re-evaluated: learning rates adapt to the noise (LRA-CMA-ES). Not with limited
  // memory.
  kLra,
};

// Which rollouts of a search meet the same random numbers, so that the ranking of the candidates is
// paired (PEGASUS; A. Y. Ng and M. Jordan, UAI 2000). Comparisons of final means always are.
enum class CommonRandomNumbers {
  kOff,         // none
  kGeneration,  // those of a run's generation
  kSearch,      // all: the objective is a deterministic function of the parameters
};

struct PolicySearchOptions {
  std::int64_t evaluations = 300000;  // rollouts an episode's search may spend; [100, 1e12]
  // lambda; 0: CMA-ES's default, 4 + 3 ln P; 0 or [2, 100000]. Eight runs of 12 candidates are two
  // full tiles of lanes, and find good policies of networks sooner than the default
  // (docs/search.md).
  int population = 12;
  int rollouts = 1;       // rollouts a candidate, more in the later stages of the selection
                          // (within max_rollouts for kRollouts); [1, 10000]
  int max_rollouts = 20;  // limit of kRollouts; [1, 10000]
  int concurrent = 8;     // CMA-ES instances side by side; [1, 1024]
  // Share of the evaluations for all runs alike; the rest is for `promotions` further stages of
  // equal shares, each for half as many runs, the best; 1: no such selection; [0.1, 1].
  double exploration = 0.3;
  // Exploration asks for relaxed batches (CandidateBatch), which find good policies sooner where
  // nothing is known yet (docs/search.md). Not with exploration = 1 and kSingle, where no stage
  // would correct their ranking. For searches without a last policy: AdaptToStart turns it off.
  bool relaxed_exploration = true;
  int promotions = 3;  // stages after exploration, which fill as many lanes at least; [1, 10]
  // Share of the restarts that begin as the first run does, at the last policy with first_sigma;
  // [0, 1]. The learner takes 0 as long as there is none.
  double local_share = 0.5;
  int final_rollouts = 480;      // that compare each of the best final means, and again for the
                                 // prediction of the winner; [1, 1e6]
  double bound = 5;              // parameters lie in +-bound; > 0
  double first_sigma = 1;        // step size of the first run, from the last policy; > 0
  double restart_sigma = 5;      // restarts draw sigma = restart_sigma 10^(-decades U); > 0
  double restart_decades = 1.3;  // [0, 10]
  int threads = 1;  // OpenMP threads that update the runs of a batch, whatever the result; >= 1
  RestartStrategy restarts = RestartStrategy::kSmall;
  UncertaintyHandling uncertainty = UncertaintyHandling::kOff;
  // What CMA-ES adapts beside mean and sigma. A run ends before it could learn the whole matrix of
  // a network's parameters (docs/search.md).
  CovarianceForm covariance = CovarianceForm::kDiagonal;
  CommonRandomNumbers common_random_numbers = CommonRandomNumbers::kGeneration;
  // Tells the objective which candidates compete in a generation, so that it may stop rollouts that
  // can no longer matter. Not with kSigma or kRollouts, which rank all.
  bool stop_lost_causes = false;
};

// Evaluates a batch: parameters are rows of `parameters` (n_candidates x P, row-major, within the
// bounds), candidate c is run n_rollouts[c] times with the streams (keys[c], rollout index) and
// the sums of rewards of its rollouts are written one after the other, candidate after candidate.
// groups: with stop_lost_causes, the candidates that one generation of a run compares; their
// parents and the median must be exact, the others only worse. Otherwise empty: all must be exact.
struct CandidateBatch {
  int n_candidates = 0;
  std::span<const double> parameters;
  std::span<const StreamKey> keys;
  std::span<const int> n_rollouts;
  std::span<const int> first_rollout;  // rollout indices of candidate c start here
  std::span<const CandidateGroup> groups = {};
  // The search explores and asks for easier rollouts (Evaluator::Evaluate); an objective that has
  // none may ignore this. Comparisons and later stages never ask for them.
  bool relaxed = false;
};
using BatchObjective = std::function<void(const CandidateBatch& batch, std::span<double> returns)>;

// How one CMA-ES run ended.
struct RunRecord {
  // 0: the run from the last policy. What goes on twice has two records, the later of which has a
  // number of its own and the evaluations since then.
  int run = 0;
  bool large = false;
  int population = 0;
  double initial_sigma = 0;
  std::int64_t evaluations = 0;
  // The criterion, e.g. "TolX"; "SmallBudget" if a small run used up its share; "budget" if its
  // share of the search ended first.
  std::string stop;
  // Of its final mean: by final_rollouts fresh rollouts if it came among the finalists, else by the
  // 48 that chose them.
  double mean_return = 0;
};

class SearchRun;

struct PolicySearchProgress {
  std::int64_t evaluations = 0;
  std::int64_t budget = 0;
  int runs_started = 0;    // those that go on twice count twice
  double best_return = 0;  // best value of the last generation, all instances together
  double mean_return = 0;  // mean value of it; both that of the result after the comparison
  bool relaxed = false;    // both are of relaxed rollouts (CandidateBatch)
  // Of threads with objectives of their own, all together, that had no run while others had.
  double waiting_seconds = 0;
  // The runs under way (engine/search/search_run.h), for the time of the call; none at the end.
  std::span<const SearchRun> runs;
};

struct PolicySearchResult {
  std::vector<double> parameters;  // (P) mean of the best final distribution
  // Its mean return by final_rollouts rollouts on streams of their own, not those by which it won
  // the comparison: unbiased.
  double predicted_return = 0;
  std::int64_t evaluations = 0;  // rollouts, the final comparison included
  std::vector<RunRecord> runs;
};

// Maximises the expected return over policy parameters in +-bound with restarted active CMA-ES
// (paper, section III-D; docs/method.md). The first run starts at `start` (P), clipped to the
// bounds. Fewer instances than `concurrent` run if the budget has no 100 generations for each.
//
// The budget goes by successive halving. All instances explore alike for the share `exploration`,
// by relaxed rollouts with relaxed_exploration; a run that meets a stopping criterion makes room
// for a new one. Then all runs that may still improve are compared by 48 fresh rollouts each, and
// the best, half as many as there were instances, go on from where they were; then the same again
// with half as many, `promotions` times in all. Half as many runs take twice the `rollouts`, and
// the last ones at least 2 of them. A single one of several goes on twice, with random numbers of
// its own each time. When a promoted run converges, the next best of the runs that were passed over
// goes on in its place, or a new one starts, until no generation fits.
//
// At the end the final means of all runs and `start` itself are compared by fresh rollouts on
// common random streams, and the best is returned. Its return is predicted by as many rollouts
// again, so that the prediction has no bias from the choice; by chance it can be less than the
// comparison gave `start`. The budget covers this: final_rollouts, or a 45th of the budget if that
// is less, for each of at most 8 finalists and for the prediction.
//
// All random numbers derive from (seed, episode, run, generation, candidate), less what
// common_random_numbers leaves out; the result depends on nothing else. A return that is not finite
// counts as worse than any other.
//
// Runs go on in rounds of generations: a 64th of what the budget holds, at most 32, one with kSigma
// and kRollouts. What meets a stopping criterion waits for the end of its round. In a round the
// generations of all runs make one batch each for `objective`, which may use many threads. If there
// are own_objectives instead, one a thread, and runs for all of them, each of so many OpenMP
// threads takes some of the runs through the round on its own, with the objective of its number, at
// the same time as the others; it must return what `objective` would. What is left of the round
// when a thread finds no run any more is for `objective` again.
//
// `progress` (may be empty) is called after every round; `stop` (may be null) is looked at between
// batches and ends the search by throwing Interrupted. Throws InvalidInput for options out of
// range, an empty or non-finite start, or a budget that holds not even one generation.
PolicySearchResult SearchPolicy(const PolicySearchOptions& options, std::span<const double> start,
                                std::uint64_t seed, std::uint32_t episode,
                                const BatchObjective& objective,
                                const std::function<void(const PolicySearchProgress&)>& progress,
                                const std::atomic<bool>* stop,
                                std::span<const BatchObjective> own_objectives = {});

}  // namespace downpour
