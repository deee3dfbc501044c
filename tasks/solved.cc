// SPDX-License-Identifier: Apache-2.0
#include "tasks/solved.h"

#include <cmath>
#include <cstddef>
#include <numbers>

namespace downpour {

bool HoldsThroughLastSecond(std::span<const double> states, int n_states, double control_period,
                            const std::function<bool(std::span<const double>)>& holds) {
  const std::size_t width = static_cast<std::size_t>(n_states);
  const std::size_t n_rows = states.size() / width;
  const std::size_t n_last = static_cast<std::size_t>(std::lround(1.0 / control_period)) + 1;
  if (n_rows < n_last) return false;
  for (std::size_t row = n_rows - n_last; row < n_rows; ++row) {
    if (!holds(states.subspan(row * width, width))) return false;
  }
  return true;
}

bool IsUpright(double angle) {
  const double error = std::remainder(angle - std::numbers::pi, 2 * std::numbers::pi);
  return std::abs(error) <= 10 * std::numbers::pi / 180;
}

}  // namespace downpour
