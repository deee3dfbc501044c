// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "engine/rollout/task.h"

namespace downpour {

// What R rollouts of H steps go through, candidate after candidate; row-major.
struct Trajectories {
  std::vector<double> states;   // (R x (H + 1) x E), the start first; any number once diverged
  std::vector<double> inputs;   // (R x H x (F + A)) the model's: features, action
  std::vector<double> rewards;  // (R x H) of the states after the steps; NaN once diverged

  // Room for `n_rollouts` of them.
  Trajectories(const Task& task, int n_rollouts);
  Trajectories() = default;

  // Takes lane `lane` of a tile's states, inputs and rewards at `step`, [0, H], for `rollout`. An
  // `alive` of 0 stands for a rollout that has diverged.
  void Record(const Task& task, int rollout, int step, int lane, const double* tile_states,
              const double* tile_inputs, const double* tile_rewards, const double* alive);
};

}  // namespace downpour
