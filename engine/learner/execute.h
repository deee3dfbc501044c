// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "engine/learner/learner.h"

namespace downpour {

// One episode on the real system.
struct Execution {
  std::vector<Transition> transitions;  // (H)
  double real_return = 0;               // sum of the rewards of the H noise-free next states
  bool solved = false;                  // task.solved of the H + 1 noise-free states
};

// Writes the action (A) of `step` for the features (F) of its observation.
using Controller =
    std::function<void(int step, std::span<const double> features, std::span<double> action)>;

// Runs `task.horizon` steps from the start state start_mean + start_std z, z from `start_key`.
// observation_t = state_t + observation_std z_t, z_t from `noise_key` at counter t: one draw a
// time, which is next_observation of step t - 1 and observation of step t. Actions are clipped to
// the limits. Throws InvalidInput if the system or the controller gives a number that is not
// finite.
Execution ExecuteEpisode(const Task& task, System& system, int episode, StreamKey start_key,
                         StreamKey noise_key, const Controller& controller);

}  // namespace downpour
