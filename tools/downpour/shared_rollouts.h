// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "engine/learner/rollout_helpers.h"
#include "engine/learner/run_directory.h"
#include "tools/downpour/config.h"
#include "tools/downpour/mpi_world.h"

namespace downpour {

// Throws InvalidInput if the rollouts of a run depend on who shares in them.
void CheckShareable(const RunConfig& config);

// Rank 0's side of a run whose rollouts all ranks share in. A batch is cut where the evaluator's
// vectors end, so that results and counts are those of one process.
class SharedRollouts : public RolloutHelpers {
 public:
  // Hands the run's settings and its task to the other ranks and waits until they are ready. Throws
  // InvalidInput if one of them would give other bits, std::runtime_error if one fails. `threads`
  // are those of this process.
  SharedRollouts(MpiWorld* world, const RunDirectory& run, int threads);

  void SetModel(std::span<const QueryFactor> factors, std::span<const double> prior) override;
  void Evaluate(const CandidateBatch& batch, Evaluator* evaluator,
                std::span<double> returns) override;
  int threads() const override { return first_thread_.back(); }

 private:
  // An answer of every helper; [rank], that of rank 0 empty.
  std::vector<std::string> Answers();
  MpiWorld* world_;
  std::vector<int> first_thread_;  // of each rank; then of all together, how many
};

// The other ranks' side, until rank 0 ends it. What fails here fails there.
void HelpWithRollouts(MpiWorld* world);

}  // namespace downpour
