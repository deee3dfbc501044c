// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>

namespace downpour {

// Parts of the tasks' "solved" tests. Thread-safe, no allocation.

// True if `holds` is true of every state of the last second. `states` are rows of n_states numbers,
// one row every control_period seconds, the start included: with 10 Hz and 40 steps the rows
// 30, 31, ..., 40. False if there is less than a second of states.
bool HoldsThroughLastSecond(std::span<const double> states, int n_states, double control_period,
                            const std::function<bool(std::span<const double>)>& holds);

// True if a pole at `angle` (rad, 0 hangs down, not wrapped) is within 10 degrees of upright.
// False for NaN.
bool IsUpright(double angle);

}  // namespace downpour
