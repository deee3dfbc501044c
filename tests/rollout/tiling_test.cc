// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/tiling.h"

#include <doctest/doctest.h>

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
        if (tile + 1 < tiling.count()) CHECK(tiling.Size(tile) % Tiling::kVectorLanes == 0);
        next += tiling.Size(tile);
      }
      CHECK(next == n);
      CHECK(tiling.computed_lanes() - n >= 0);
      CHECK(tiling.computed_lanes() - n < Tiling::kVectorLanes);
    }
  }
}

TEST_CASE("tiling: tiles differ by a vector, and every thread gets the same number of them") {
  for (const int threads : {1, 2, 3, 16}) {
    for (int n = 1; n <= 500; ++n) {
      const Tiling tiling(n, threads);
      const int vectors = tiling.computed_lanes() / Tiling::kVectorLanes;
      CHECK((tiling.count() % threads == 0 || tiling.count() == vectors));
      const auto vectors_of = [&](int tile) {
        return (tiling.Size(tile) + Tiling::kVectorLanes - 1) / Tiling::kVectorLanes;
      };
      CHECK(vectors_of(0) - vectors_of(tiling.count() - 1) <= 1);
    }
  }
  // No more tiles than one thread needs.
  CHECK(Tiling(132, 1).count() == 3);
  CHECK(Tiling(132, 2).count() == 4);
  CHECK(Tiling(2147483599, 2).First(Tiling(2147483599, 2).count()) == 2147483599);
}

}  // namespace
}  // namespace downpour
