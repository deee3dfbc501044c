// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/tiling.h"

#include <doctest/doctest.h>

#include <algorithm>

namespace downpour {
namespace {

TEST_CASE("tiling: every lane is in one tile, and every tile but the last holds whole vectors") {
  for (const int threads : {1, 2, 3, 16}) {
    for (int n = 0; n <= 500; ++n) {
      const Tiling tiling(n, threads);
      int next = 0;
      for (int tile = 0; tile < tiling.count(); ++tile) {
        CHECK(tiling.First(tile) == next);
        CHECK(tiling.Size(tile) >= 1);
        CHECK(tiling.Size(tile) <= kTileLanes);
        if (tile + 1 < tiling.count()) CHECK(tiling.Size(tile) % tiling.unit() == 0);
        next += tiling.Size(tile);
      }
      CHECK(next == n);
      CHECK(tiling.computed_lanes() - n >= 0);
      CHECK(tiling.computed_lanes() - n < Tiling::kVectorLanes);
    }
  }
}

TEST_CASE("tiling: tiles differ by a unit, and every thread gets the same number of them") {
  for (const int threads : {1, 2, 3, 16}) {
    for (int n = 1; n <= 500; ++n) {
      const Tiling tiling(n, threads);
      const auto units_of = [&](int lanes) { return (lanes + tiling.unit() - 1) / tiling.unit(); };
      CHECK((tiling.count() % threads == 0 || tiling.count() == units_of(n)));
      CHECK(units_of(tiling.Size(0)) - units_of(tiling.Size(tiling.count() - 1)) <= 1);
    }
  }
  // No more tiles than one thread needs.
  CHECK(Tiling(132, 1).count() == 3);
  CHECK(Tiling(132, 2).count() == 4);
  CHECK(Tiling(2147483599, 3).First(Tiling(2147483599, 3).count()) == 2147483599);
  CHECK(Tiling(2147483599, 2).First(Tiling(2147483599, 2).count()) == 2147483599);
}

TEST_CASE("tiling: halves of vectors where the largest tile becomes smaller, not for one thread") {
  const Tiling four(96, 4);
  CHECK(four.count() == 4);
  CHECK(four.Size(0) == 24);
  CHECK(four.Size(3) == 24);
  CHECK(Tiling(96, 12).Size(0) == 8);
  CHECK(Tiling(96, 2).unit() == Tiling::kVectorLanes);
  CHECK(Tiling(128, 12).unit() == Tiling::kVectorLanes);  // two threads have 16 lanes either way
  CHECK(Tiling(80, 1).unit() == Tiling::kVectorLanes);
  for (const int threads : {2, 3, 4, 5, 8, 16}) {
    for (int n = 1; n <= 500; ++n) {
      const Tiling tiling(n, threads);
      // Lanes of the thread with the most, rounded up to half vectors: no even cut has fewer.
      const int rounds = (tiling.count() + threads - 1) / threads;
      const int halves = (n + Tiling::kHalfVectorLanes - 1) / Tiling::kHalfVectorLanes;
      const int tiles = std::min(halves, rounds * threads);
      CHECK(tiling.Size(0) <= (halves + tiles - 1) / tiles * Tiling::kHalfVectorLanes);
    }
  }
}

}  // namespace
}  // namespace downpour
