// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "engine/learner/learner.h"
#include "tasks/mujoco_system.h"

namespace downpour {

// The model's joint positions (nq) at `times` (s, ascending, from 0 to the end of the episode):
// simulated again from `start` with the actions of `transitions`, an episode's. Throws InvalidInput
// if a state does not come out as recorded: another model, or another MuJoCo.
std::vector<std::vector<double>> Replay(const Task& task, MujocoSystem* system,
                                        std::span<const double> start,
                                        std::span<const Transition> transitions,
                                        std::span<const double> times);

// The state (E) at `position` in steps, [0, n - 1], between n states (n x E): a Catmull-Rom spline
// through all of them.
std::vector<double> Interpolate(std::span<const double> states, int n_states, double position);

}  // namespace downpour
