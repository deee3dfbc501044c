// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "engine/gp/query_plan.h"
#include "engine/rollout/block_functions.h"
#include "engine/rollout/evaluator.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"
#include "kernels/aligned.h"
#include "kernels/philox/philox.h"

namespace downpour {

// Where rollouts as they went are to be written, row-major: L lanes, H steps.
struct TrajectoryBuffers {
  std::span<double> states;   // L x (H + 1) x E
  std::span<double> actions;  // L x H x A
  std::span<double> rewards;  // L x H
};

// Rollouts of one batch that take every step together, so that functions on whole blocks can have
// their turn between the steps; the tiles of a step go to the threads. Random numbers, divergence,
// penalty and bits of a lane are those of Evaluator (with OpenBLAS up to rounding), and so are the
// options. The model has no learnt reward. One object is one batch.
class BlockRollouts {
 public:
  // Lane l is rollout l % n_rollouts of parameter vector l / n_rollouts; parameters n x
  // n_parameters row-major. All random numbers are those of (key, rollout), for every parameter
  // vector the same. `policy` may be null if functions.policy is set, and the task's reward if
  // functions.reward is. All must outlive the object. Allocates all that Run needs.
  BlockRollouts(const Task& task, const Policy* policy, const BlockFunctions& functions,
                std::span<const QueryFactor> factors, const EvaluatorOptions& options,
                std::span<const double> parameters, int n_parameters, int n_rollouts,
                StreamKey key);

  // Writes the sums of rewards (lanes), and the trajectories if there are any; from where a rollout
  // has diverged on, these are NaN. `stop` (may be null) is looked at before every step; once it is
  // true, throws Interrupted. Throws InvalidInput if a function gave a number that is not finite.
  // Once.
  void Run(std::span<double> returns, const TrajectoryBuffers* trajectories,
           const std::atomic<bool>* stop);

 private:
  struct Tile;
  Tile TileAt(int tile);
  int TileLanes(int tile) const;
  void StartTile(int tile, std::span<const double> parameters, StreamKey key);
  // From the features and, with functions.policy, the actions to the next states and features and,
  // without functions.reward, the rewards.
  void StepTile(int step, int tile);
  void AddRewards(int tile);
  // A tile's rows as columns [first lane, ...) of a block, or back.
  void Gather(int tile, int rows, const double* from, std::vector<double>* block) const;
  void Scatter(int tile, int rows, const std::vector<double>& block, double* to) const;
  void CallPolicy(int step);
  void CallReward(int step);
  void CheckFinite(const char* function, int step, int rows,
                   const std::vector<double>& block) const;
  void Record(int step, const TrajectoryBuffers& trajectories);
  void RecordStates(int time, const TrajectoryBuffers& trajectories);

  const Task& task_;
  const Policy* policy_;
  const BlockFunctions& functions_;
  std::span<const QueryFactor> factors_;
  EvaluatorOptions options_;
  int n_parameters_, n_rollouts_, lanes_, n_tiles_;
  std::size_t tile_size_ = 0;  // doubles a tile
  AlignedVector<double> tiles_;
  AlignedVector<std::uint32_t> streams_;          // keys0, keys1, rollouts: kTileLanes each a tile
  AlignedVector<double> rewards_, sums_, alive_;  // lanes rounded up to tiles
  std::size_t gp_scratch_size_ = 0;               // doubles a thread
  AlignedVector<double> gp_scratch_;
  std::vector<double> parameter_block_, state_block_, feature_block_, action_block_;
};

}  // namespace downpour
