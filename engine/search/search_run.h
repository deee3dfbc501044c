// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "engine/search/bipop.h"
#include "engine/search/bounds.h"
#include "engine/search/cma_es.h"
#include "engine/search/policy_search.h"
#include "engine/search/uncertainty.h"

namespace downpour {

// The batch that all runs of a search share in a generation; see CandidateBatch.
struct SearchBatch {
  std::vector<double> parameters, returns;
  std::vector<StreamKey> keys;
  std::vector<int> n_rollouts, first_rollout;
  std::vector<CandidateGroup> groups;
  std::size_t n_candidates = 0, n_returns = 0;  // laid out so far
  bool relaxed = false;

  CandidateBatch Candidates() const {
    return {static_cast<int>(n_candidates),
            parameters,
            keys,
            n_rollouts,
            first_rollout,
            groups,
            relaxed};
  }
};

// One CMA-ES run of a policy search, with uncertainty handling. A generation is Plan, Ask, Tell.
// Random numbers derive from (seed, episode, run, generation, candidate), see
// CommonRandomNumbers. Not thread-safe.
class SearchRun {
 public:
  // Starts at `mean` (P, within the bounds).
  SearchRun(const PolicySearchOptions& options, const RunPlan& plan, std::vector<double> mean,
            std::uint64_t seed, std::uint32_t episode);

  const RunPlan& plan() const { return plan_; }
  std::int64_t evaluations() const { return evaluations_; }
  // The criterion that ends it, or empty. A promoted run does not end for "Stagnation": it was
  // among the best, and keeps its share although its progress is slow.
  std::string_view stop() const {
    return promoted_ && cma_.stop() == "Stagnation" ? std::string_view() : cma_.stop();
  }
  std::span<const double> costs() const { return costs_; }  // of the last generation
  std::vector<double> Mean() const;                         // (P) within the bounds
  // Goes on with at least so many rollouts a candidate (under kRollouts within its limit).
  void Promote(int min_rollouts);
  bool promoted() const { return promoted_; }
  // The same run from here on with other random numbers, those of run number `run`; evaluations()
  // begins at 0.
  SearchRun Fork(int run) const;
  int dimension() const { return cma_.dimension(); }
  // Whether some candidates are evaluated twice, and rollouts may change.
  bool reevaluates() const {
    return uncertainty_ == UncertaintyHandling::kSigma ||
           uncertainty_ == UncertaintyHandling::kRollouts;
  }
  // What of the ranking matters: the parents, and the median, which stopping criteria look at.
  CandidateGroup group() const { return {plan_.population, plan_.population / 2 + 1}; }
  // Rollouts of the next generation.
  std::int64_t NextReturns() const;

  // Takes the next part of the batch.
  void Plan(SearchBatch* batch);
  // Writes that part: the population, then its first candidates again with other streams.
  void Ask(SearchBatch* batch);
  // Reads its returns.
  void Tell(const SearchBatch& batch);

 private:
  std::size_t n_candidates() const { return costs_.size() + reevaluated_.size(); }
  // What the next generation evaluates twice.
  std::size_t NextReevaluations() const;
  // Of the rollouts of this generation's candidates, or of their second evaluations.
  void FillRolloutKeys(StreamPurpose purpose, std::span<StreamKey> keys) const;

  RunPlan plan_;
  UncertaintyHandling uncertainty_;
  CommonRandomNumbers common_random_numbers_;
  int min_rollouts_, max_rollouts_;
  BoxTransform box_;
  CmaEs cma_;
  UncertaintyMeasure measure_;
  std::uint64_t seed_;
  std::uint32_t episode_;
  double rollouts_;  // a candidate, before rounding
  bool promoted_ = false;
  std::int64_t evaluations_ = 0;
  // This generation.
  std::size_t n_rollouts_ = 0, first_candidate_ = 0, first_return_ = 0;
  std::vector<double> costs_, reevaluated_;
  std::vector<int> ranking_;
};

// Plans the next generation of all runs in a batch and makes room for it, the candidates of each
// run a group if `grouped`.
void LayOut(std::span<SearchRun* const> runs, bool grouped, SearchBatch* batch);

// The candidates that the runs will ask for next. Allocates.
SearchBatch NextGeneration(std::span<const SearchRun> runs);

}  // namespace downpour
