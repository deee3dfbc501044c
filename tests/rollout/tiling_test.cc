// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/tiling.h"

#include <doctest/doctest.h>

#include <utility>
#include <vector>

namespace downpour {
namespace {

constexpr std::pair<int, int> kCases[] = {{1, 16}, {2, 16}, {3, 16}, {16, 16}, {1, 8},
                                          {2, 8},  {3, 8},  {4, 8},  {16, 8}};

TEST_CASE("tiling: every lane is in one tile, and every tile but the last holds whole units") {
  for (const auto& [threads, unit] : kCases) {
    for (int n = 0; n <= 500; ++n) {
      const Tiling tiling(n, threads, unit);
      int next = 0;
      for (int tile = 0; tile < tiling.count(); ++tile) {
        CHECK(tiling.First(tile) == next);
        CHECK(tiling.Size(tile) >= 1);
        CHECK(tiling.Size(tile) <= kTileLanes);
        if (tile + 1 < tiling.count()) CHECK(tiling.Size(tile) % unit == 0);
        next += tiling.Size(tile);
      }
      CHECK(next == n);
      CHECK(tiling.computed_lanes() - n >= 0);
      CHECK(tiling.computed_lanes() - n < unit);
    }
  }
}

TEST_CASE("tiling: tiles differ by a unit, and every thread gets the same number of them") {
  for (const auto& [threads, unit] : kCases) {
    for (int n = 1; n <= 500; ++n) {
      const Tiling tiling(n, threads, unit);
      const int units = tiling.computed_lanes() / unit;
      CHECK((tiling.count() % threads == 0 || tiling.count() == units));
      // The first tile is the largest and the last the smallest.
      const int largest = (tiling.Size(0) + unit - 1) / unit;
      const int smallest = (tiling.Size(tiling.count() - 1) + unit - 1) / unit;
      CHECK(largest - smallest <= 1);
    }
  }
  // No more tiles than one thread needs.
  CHECK(Tiling(132, 1, 16).count() == 3);
  CHECK(Tiling(132, 2, 16).count() == 4);
  CHECK(Tiling(2147483599, 2, 16).First(Tiling(2147483599, 2, 16).count()) == 2147483599);
}

TEST_CASE("tiling: small units let more threads share a batch evenly") {
  CHECK(Tiling(96, 4, 16).Size(0) == 32);
  CHECK(Tiling(96, 4, 8).Size(0) == 24);
  CHECK(Tiling(96, 4, 8).Size(3) == 24);
  CHECK(Tiling(96, 12, 8).Size(11) == 8);
}

TEST_CASE("tiling: the unit is a vector of what the factors hold") {
  const int floats = SimdFloatLanes();
  const std::vector<QueryFactor> doubles = {GpFactor{}, GpFactor{}};
  const std::vector<QueryFactor> mixed = {GpFactor{}, GpFactor32{}};
  CHECK(TileUnit(mixed) == (floats == 16 ? 16 : 8));
  CHECK(TileUnit(doubles) == 8);
}

}  // namespace
}  // namespace downpour
