// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/trajectories.h"

#include <cstddef>
#include <limits>

#include "kernels/aligned.h"
#include "kernels/gp_query/gp_query.h"

namespace downpour {
namespace {

// Column `lane` of a tile (rows x kTileLanes).
void CopyLane(const double* tile, int lane, int rows, double* out) {
  for (int i = 0; i < rows; ++i) out[i] = tile[i * kTileLanes + lane];
}

}  // namespace

Trajectories::Trajectories(const Task& task, int n_rollouts) {
  const std::size_t n_steps = static_cast<std::size_t>(n_rollouts) * task.horizon;
  states.resize((n_steps + n_rollouts) * task.n_states());
  inputs.resize(n_steps * task.n_inputs());
  rewards.resize(n_steps);
}

void Trajectories::Record(const Task& task, int rollout, int step, int lane,
                          const double* tile_states, const double* tile_inputs,
                          const double* tile_rewards, const double* alive) {
  const std::size_t row = static_cast<std::size_t>(rollout) * task.horizon + step;
  // A rollout has one state more than steps.
  CopyLane(tile_states, lane, task.n_states(), &states[(row + rollout) * task.n_states()]);
  if (step > 0) {
    rewards[row - 1] =
        alive[lane] != 0 ? tile_rewards[lane] : std::numeric_limits<double>::quiet_NaN();
  }
  if (step == task.horizon) return;
  CopyLane(tile_inputs, lane, task.n_inputs(), &inputs[row * task.n_inputs()]);
}

}  // namespace downpour
