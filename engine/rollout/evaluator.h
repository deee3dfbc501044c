// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "engine/gp/query_plan.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"
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

// Counts of all Evaluate calls so far.
struct EvaluatorStatistics {
  std::int64_t rollouts = 0;
  std::int64_t gp_queries = 0;  // rollouts x horizon x E
  std::int64_t lanes = 0;       // computed, idle ones in vectors included: fill = rollouts / lanes
  std::int64_t diverged = 0;    // rollouts that got the penalty
  double seconds = 0;           // wall time of the calls; no result depends on it
};

// The batched evaluator (docs/method.md): rollouts are packed into tiles (tiling.h), one thread
// takes one tile through all steps (features, policy, GP queries, sample, reward), one OpenMP
// region a call. If any factor is one for OpenBLAS, a thread takes a block of up to kBlasTiles
// whole tiles. Results are the same bits for any thread count and, without OpenBLAS, any packing of
// candidates.
//
// A rollout whose state is not finite, or beyond kStateLimit (the vector sine's range), has
// diverged: it stops and its return is -horizon, below any return of rewards in [0, 1].
class Evaluator {
 public:
  static constexpr double kStateLimit = 30000;

  // factors: one an output, D = F + A. Task, policy and factors must outlive the evaluator. Throws
  // InvalidInput if sizes disagree.
  Evaluator(const Task& task, const Policy& policy, std::span<const QueryFactor> factors,
            const EvaluatorOptions& options);

  // Goes on with other factors, checked as in the constructor. Allocates.
  void SetFactors(std::span<const QueryFactor> factors);

  // Sums of rewards over the horizon. Candidate c has the parameters in row c of `parameters`
  // (n x P row-major), runs n_rollouts[c] rollouts numbered from first_rollout[c] with stream
  // keys[c]; returns are written candidate after candidate. Start states are start_mean +
  // start_std z. Not thread-safe; scratch grows only when a batch is larger than all before.
  void Evaluate(std::span<const double> parameters, std::span<const StreamKey> keys,
                std::span<const int> n_rollouts, std::span<const int> first_rollout,
                std::span<double> returns);

  // The model's inputs (features, action) that one rollout a candidate meets: row c horizon + t of
  // the result (n horizon x D, row-major) is that of candidate c at step t. Not counted in the
  // statistics. Allocates.
  std::vector<double> VisitedInputs(std::span<const double> parameters,
                                    std::span<const StreamKey> keys);

  const EvaluatorStatistics& statistics() const { return statistics_; }

 private:
  struct Lane {
    int candidate;
    std::uint32_t rollout;
  };
  struct TileScratch;
  // Runs lanes [first, first + n), a block, through all steps and writes their returns. `scratch`
  // holds scratch_size_ doubles.
  void RunBlock(std::span<const double> parameters, std::span<const StreamKey> keys, int first,
                int n, double* scratch, double* returns, double* visited) const;
  void PackTile(std::span<const double> parameters, std::span<const StreamKey> keys, int first,
                int n, TileScratch* scratch) const;
  // Actions of the tile's first n lanes, which are lanes [first, first + n) of the batch.
  void ActTile(std::uint32_t step, int first, int n, const TileScratch& scratch,
               double* visited) const;
  // Means and variances of all outputs for the block's n lanes.
  void QueryBlock(int n, std::span<const TileScratch> tiles, double* gp_scratch) const;
  void AdvanceTile(std::uint32_t step, const TileScratch& scratch) const;
  // Evaluate without statistics; visited as VisitedInputs, or nullptr.
  void Run(std::span<const double> parameters, std::span<const StreamKey> keys,
           std::span<const int> n_rollouts, std::span<const int> first_rollout,
           std::span<double> returns, double* visited);

  const Task& task_;
  const Policy& policy_;
  std::span<const QueryFactor> factors_;
  EvaluatorOptions options_;
  int block_tiles_ = 1;
  std::size_t tile_size_ = 0;     // doubles of scratch a tile
  std::size_t scratch_size_ = 0;  // doubles a thread: the block's tiles and a query's
  AlignedVector<double> scratch_;
  std::vector<Lane> lanes_;
  EvaluatorStatistics statistics_;
};

// Features (F) of one state (E): the same numbers as in the tile.
void ComputeFeatures(const Task& task, std::span<const double> state, std::span<double> features);
// Reward of one state (E).
double ComputeReward(const Task& task, std::span<const double> state);

}  // namespace downpour
