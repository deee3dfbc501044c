// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "engine/learner/learner.h"

namespace downpour {

// One episode on the real system.
struct Execution {
  std::vector<Transition> transitions;  // (H), fewer if the episode was cut short
  double real_return = 0;               // sum of their rewards
  bool solved = false;                  // task.solved of the H + 1 noise-free states
  std::string outcome = kComplete;      // EpisodeRecord::outcome
};

// Writes the action (A) of `step` for the features (F) of its observation.
using Controller =
    std::function<void(int step, std::span<const double> features, std::span<double> action)>;

// Runs `task.horizon` steps from the start state start_mean + start_std z, z from `start_key`.
// observation_t = state_t + observation_std z_t, z_t from `noise_key` at counter t: one draw a
// time, which is next_observation of step t - 1 and observation of step t. Actions are clipped to
// the limits. Throws InvalidInput if the system or the controller gives a number that is not
// finite, or a reward is beyond +-Reward::kLimit.
//
// On a measured system (System::measured) no noise is added, the states measured stand for the
// noise-free ones, and the system's own reward comes before the task's. It may end the episode
// early. Whatever else ends it after the first step is no exception but the outcome, as steps on
// hardware cannot be had again; before the first step, the exception goes on to the caller. An
// episode of less than H steps is not solved.
Execution ExecuteEpisode(const Task& task, System& system, int episode, StreamKey start_key,
                         StreamKey noise_key, const Controller& controller);

}  // namespace downpour
