// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"
#include "kernels/philox/philox.h"

namespace downpour {

// Policy parameters (P) to search from, drawn as the authors of PILCO do (Deisenroth, Fox and
// Rasmussen, TPAMI 2015; settings of their program):
//   gp      pseudo-inputs: features of states drawn from the task's start distribution;
//           pseudo-targets: 0.1 z; length-scales of 1 in the feature's own unit, 0.7 of a sine or
//           cosine
//   linear  W: 0.1 z; b: 0
// with z standard normal. Depends on nothing but its arguments. Throws InvalidInput for other kinds
// of policy.
std::vector<double> DrawPilcoStart(const Task& task, const PolicyOptions& policy, StreamKey key);

}  // namespace downpour
