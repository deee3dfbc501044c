// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "engine/learner/saved_policy.h"

namespace downpour {

// A C99 header (also C++17) with the policy as numbers, which needs <math.h> alone:
//   static inline void downpour_policy(const double state[E], double action[A]);
// for dmp: downpour_policy(const double state[E], int step, double action[A]). It computes the
// task's features, numbers read back exactly, and |action_i| <= limit. Actions differ from those of
// Policy::Act by the rounding of sums and elementary functions alone; those of dmp are equal.
// Throws InvalidInput as MakePolicy does.
std::string CHeader(const SavedPolicy& saved, const Task& task);

}  // namespace downpour
