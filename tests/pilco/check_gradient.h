// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace downpour {

// Each entry of `gradient` within 1e-6 of itself, or of 1e-2 of the largest, of central differences
// with two steps extrapolated (Richardson): error O(h^4) and eps / h.
template <typename Function>
void CheckGradient(const std::vector<double>& gradient, const std::vector<double>& x,
                   const Function& function) {
  const double h = std::pow(std::numeric_limits<double>::epsilon(), 0.2);
  const auto difference = [&](std::size_t p, double step) {
    std::vector<double> y = x;
    y[p] = x[p] + step;
    const double above = function(y);
    y[p] = x[p] - step;
    return (above - function(y)) / (2 * step);
  };
  double largest = 0;
  for (const double g : gradient) largest = std::max(largest, std::abs(g));
  CHECK(largest > 0);
  for (std::size_t p = 0; p < x.size(); ++p) {
    const double step = h * std::max(1.0, std::abs(x[p]));
    const double numeric = (4 * difference(p, step / 2) - difference(p, step)) / 3;
    CAPTURE(p);
    CAPTURE(gradient[p]);
    CAPTURE(numeric);
    CHECK(std::abs(gradient[p] - numeric) <= 1e-6 * std::max(std::abs(numeric), 1e-2 * largest));
  }
}

}  // namespace downpour
