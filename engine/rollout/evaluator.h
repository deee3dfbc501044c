// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "engine/candidate_group.h"
#include "engine/gp/query_plan.h"
#include "engine/rollout/evaluator_statistics.h"
#include "engine/rollout/lost_causes.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/prior_pool.h"
#include "engine/rollout/task.h"
#include "engine/rollout/trajectories.h"
#include "kernels/aligned.h"
#include "kernels/gp_query/gp_query.h"
#include "kernels/philox/philox.h"

namespace downpour {

struct EvaluatorOptions {
  bool use_variance = true;   // false: propagate means only (the paper's "No Var")
  bool predict_noise = true;  // add the noise variance to the latent variance
  double sample_clamp = 0;    // > 0: samples stay within mean +- clamp std; 0: no clamp
  int threads = 1;            // OpenMP threads, >= 1
};

// The batched evaluator (docs/method.md): rollouts are packed into tiles (tiling.h), one thread
// takes one tile through all steps (features, policy, GP queries, sample, reward), one OpenMP
// region a call. If any factor is one for OpenBLAS, a thread takes a block of up to kBlasTiles
// whole tiles. Results are the same bits for any thread count and, without OpenBLAS, any packing of
// candidates.
//
// Rewards are the task's, or learnt: a GP on the features of the new state, sampled as the states
// are (variable E of the step's stream). With a prior (Task::prior) the next state is its
// prediction from the state and the action plus what the model says, which is then the residual.
//
// A rollout whose state is not finite, or beyond kStateLimit (the vector sine's range), or whose
// reward is not finite, or beyond Reward::kLimit, has diverged: it stops and its return is the
// penalty, below any return without: -horizon if rewards are in [0, 1], else
// -(Reward::kLimit + 1) horizon. A learnt reward may leave [0, 1].
class Evaluator {
 public:
  static constexpr double kStateLimit = 30000;
  static constexpr double kRelaxedDeviation = 0.5;  // of relaxed rollouts' normal numbers

  // factors: one a state variable, D = F + A, and after these, if the reward is learnt, its own,
  // D = F. prior: its parameters, as many as the task's prior has. Task, policy and factors must
  // outlive the evaluator. Throws InvalidInput if sizes disagree.
  Evaluator(const Task& task, const Policy& policy, std::span<const QueryFactor> factors,
            const EvaluatorOptions& options, std::span<const double> prior = {});

  // Goes on with other factors, checked as in the constructor. Allocates.
  void SetFactors(std::span<const QueryFactor> factors);

  // From now on the clock is read between kernels, about 1 ns a query: EvaluatorStatistics::parts.
  void TimeParts() { part_times_.resize(options_.threads); }

  // Sums of rewards over the horizon. Candidate c has the parameters in row c of `parameters`
  // (n x P row-major), runs n_rollouts[c] rollouts numbered from first_rollout[c] with stream
  // keys[c]; returns are written candidate after candidate. Start states are start_mean +
  // start_std z. Not thread-safe; scratch grows only when a batch is larger than all before.
  //
  // groups: if not empty, they cover the candidates in order (n_rollouts >= 1, n_exact >= 1), and
  // rollouts stop once their candidate cannot be among the n_exact best of its group any more
  // (lost_causes.h); rewards must be in [0, 1]. Those that are, and their order, are as without
  // groups, and so are the bits of all returns of candidates that run to the end (with OpenBLAS up
  // to rounding). The return of a rollout that was stopped is its sum so far, and at most what it
  // would have been unless it would have diverged; its candidate's mean is below that of the
  // n_exact best.
  //
  // relaxed: rollouts with less noise and wider rewards, for a search that explores: the normal
  // numbers of samples are multiplied by kRelaxedDeviation (before they are clamped), those of
  // learnt rewards too, and known rewards in [0, 1] count by their square roots. Start states and
  // what has diverged are as ever; without use_variance only the roots remain.
  void Evaluate(std::span<const double> parameters, std::span<const StreamKey> keys,
                std::span<const int> n_rollouts, std::span<const int> first_rollout,
                std::span<double> returns, std::span<const CandidateGroup> groups = {},
                bool relaxed = false);

  // What the rollouts 0, ..., n_rollouts[c] - 1 of each candidate go through. Not counted in the
  // statistics. Allocates.
  Trajectories Trace(std::span<const double> parameters, std::span<const StreamKey> keys,
                     std::span<const int> n_rollouts);

  const EvaluatorStatistics& statistics() const { return statistics_; }
  // Adds what others have done of a batch whose rest was evaluated here.
  void Count(const EvaluatorStatistics& others) { statistics_ += others; }

 private:
  struct Batch {
    std::span<const double> parameters;
    std::span<const StreamKey> keys;
    std::span<const int> n_rollouts, first_rollout;
    std::span<double> returns;
    Trajectories* trajectories;  // of Trace, or nullptr
    bool relaxed;
  };
  struct Lane {
    int candidate;
    std::uint32_t rollout;
    int index;  // of its return
  };
  struct TileScratch;
  void Check(const Batch& batch) const;
  // All steps of all rollouts, or what LostCauses asks for.
  void Run(const Batch& batch, std::span<const CandidateGroup> groups);
  // Steps [leg.begin, leg.end) of some candidates' rollouts. From the end of a leg before the
  // horizon to the beginning of the next, returns hold sums so far, or the penalty.
  void RunLeg(const Batch& batch, const RolloutLeg& leg);
  // Runs lanes [first, first + n), a block, through the leg and writes their returns. `scratch`
  // holds scratch_size_ doubles.
  void RunBlock(const Batch& batch, const RolloutLeg& leg, int first, int n, double* scratch);
  void PackTile(const Batch& batch, int first, int n, TileScratch* scratch) const;
  void StartTile(TileScratch* scratch) const;
  // A tile's states, sums and whether it has diverged, between two legs.
  void LoadTile(const Batch& batch, int first, int n, TileScratch* scratch) const;
  void SaveTile(int first, int n, const TileScratch& scratch);
  // What the tile's first n lanes, lanes [first, first + n) of the leg, have come to at `step`.
  void RecordTile(int step, int first, int n, const TileScratch& scratch,
                  Trajectories* trajectories) const;
  // Means and variances of an output for the block's n lanes.
  void QueryBlock(int output, int n, std::span<const TileScratch> tiles, double* gp_scratch) const;
  // Adds samples of an output to `values` (a row); lanes beyond +-limit die.
  void SampleTile(int output, double limit, const TileScratch& scratch, double* values) const;
  // From the queries' answers for n lanes to the next states and features.
  void AdvanceTile(std::uint32_t step, int n, bool relaxed, const TileScratch& scratch,
                   PartClock* clock);
  // Adds the rewards of the new states to the sums.
  void RewardTile(std::uint32_t step, bool relaxed, const TileScratch& scratch) const;
  int n_outputs() const { return static_cast<int>(factors_.size()); }
  bool learnt_reward() const { return n_outputs() > task_.n_states(); }

  const Task& task_;
  const Policy& policy_;
  std::span<const QueryFactor> factors_;
  EvaluatorOptions options_;
  PriorPool prior_;
  double penalty_ = 0;  // return of a rollout that has diverged
  int block_tiles_ = 1;
  std::size_t tile_size_ = 0;     // doubles of scratch a tile
  std::size_t scratch_size_ = 0;  // doubles a thread: the block's tiles and a query's
  AlignedVector<double> scratch_;
  std::vector<Lane> lanes_;  // of the leg
  LostCauses lost_causes_;
  std::vector<int> all_;           // candidates by index
  std::vector<int> first_return_;  // of each candidate
  std::vector<double> carried_;    // states (E) of each rollout between two legs
  EvaluatorStatistics statistics_;
  double busy_seconds_ = 0;            // that threads have spent on tiles, all together
  std::vector<PartTimes> part_times_;  // of each thread in the present call; empty: not wanted
};

}  // namespace downpour
