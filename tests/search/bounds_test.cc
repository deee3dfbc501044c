// SPDX-License-Identifier: Apache-2.0
#include "engine/search/bounds.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <utility>

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

TEST_CASE("bounds: every point of the box has a preimage that maps back to it") {
  for (const auto& [lower, upper] :
       std::initializer_list<std::pair<double, double>>{{-5, 5}, {-1, 1}, {0, 0.01}, {-3, 40}}) {
    const BoxTransform box(lower, upper);
    for (int i = 0; i <= 1000; ++i) {
      const double y = i == 1000 ? upper : lower + (upper - lower) * i / 1000;
      CHECK(std::abs(box.ToBox(box.FromBox(y)) - y) <=
            16 * kEps * std::max(std::abs(lower), std::abs(upper)));
    }
  }
}

TEST_CASE("bounds: no number leaves the box and the inside is left as it is") {
  const BoxTransform box(-5, 5);
  for (double x = -200; x < 200; x += 0.01) {
    CHECK(box.ToBox(x) >= -5);
    CHECK(box.ToBox(x) <= 5);
    if (std::abs(x) < 4.69) CHECK(box.ToBox(x) == doctest::Approx(x).epsilon(1e-13));
  }
  CHECK(std::abs(box.ToBox(1e30)) <= 5);
}

TEST_CASE("bounds: the map is smooth, symmetric, mirrored at its ends and periodic") {
  const BoxTransform box(-5, 5);
  constexpr double kMargin = 0.3, kPeriod = 2 * (10 + 2 * kMargin), kStep = 1e-5;
  double slope_before = (box.ToBox(-30 + kStep) - box.ToBox(-30 - kStep)) / (2 * kStep);
  for (double x = -30; x < 30; x += 1e-3) {
    CHECK(box.ToBox(-x) == doctest::Approx(-box.ToBox(x)).epsilon(1e-12));
    CHECK(std::abs(box.ToBox(x + kPeriod) - box.ToBox(x)) < 1e-13);
    const double slope = (box.ToBox(x + kStep) - box.ToBox(x - kStep)) / (2 * kStep);
    // The second derivative is at most 1 / (2 margin), twice that across a mirror's neighbourhood.
    CHECK(std::abs(slope - slope_before) < 1e-3 / kMargin + 1e-6);
    slope_before = slope;
  }
  CHECK(std::abs(box.ToBox(5 + kMargin + 0.1) - box.ToBox(5 + kMargin - 0.1)) < 1e-14);
  CHECK(box.ToBox(5 + kMargin) == 5);
}

}  // namespace
}  // namespace downpour
