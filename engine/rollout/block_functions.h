// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>

namespace downpour {

// A user's own features, policy and reward, called once a time step for all lanes of a batch
// together, where Policy and Reward are called for a tile at a time by many threads. Blocks are
// column-major: variable v of lane l is at [v * lanes + l]; they are valid for the time of the
// call. Calls come one at a time from the thread that evaluates; what they throw goes on to the
// caller of the evaluation. Outputs must be finite.

// features (lanes x F) of states (lanes x E).
using BlockFeatures =
    std::function<void(int step, int lanes, const double* states, double* features)>;

// Actions (lanes x A) of one step, numbered from 0, which are then clipped to the limits.
//   parameters  lanes x P, the same at every step of an evaluation; features lanes x F
using BlockPolicy = std::function<void(int step, int lanes, const double* parameters,
                                       const double* features, double* actions)>;

// Rewards (lanes) of the states (lanes x E) to which the actions (lanes x A) of `step` led.
using BlockReward = std::function<void(int step, int lanes, const double* states,
                                       const double* actions, double* rewards)>;

// Those that are empty: the task's features, its policy, its reward.
struct BlockFunctions {
  BlockFeatures features;
  BlockPolicy policy;
  BlockReward reward;
  bool any() const { return features || policy || reward; }
};

}  // namespace downpour
