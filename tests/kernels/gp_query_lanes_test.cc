// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>

#include "kernels/gp_query/gp_query.h"
#include "tests/kernels/each_target.h"
#include "tests/kernels/gp_query_cases.h"

namespace downpour {
namespace {

// Lanes of the widest vector there is (64 bytes), to which n_lanes may be rounded up.
template <typename T>
int RoundedUp(int n_lanes) {
  constexpr int kWidest = 64 / sizeof(T);
  return (n_lanes + kWidest - 1) / kWidest * kWidest;
}

TEST_CASE_TEMPLATE("gp_query: a lane's bits do not depend on how many lanes are asked for", T,
                   double, float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(1);
    for (const int n : {1, 50, 131, 270}) {
      const auto factor = RandomFactor<T>(n, 6, random, n == 131);
      const auto x = RandomQueries(6, random);
      const TileResult full = Query(factor, x);
      for (int n_lanes = 1; n_lanes <= kTileLanes; ++n_lanes) {
        CAPTURE(n_lanes);
        const TileResult part = Query(factor, x, n_lanes);
        const auto same = [&](const auto& a, const auto& b) {
          return std::equal(a.begin(), a.begin() + n_lanes, b.begin());
        };
        CHECK(same(part.mean, full.mean));
        CHECK(same(part.variance, full.variance));
      }
    }
  });
}

TEST_CASE_TEMPLATE("gp_query: lanes beyond the last vector asked for are not written", T, double,
                   float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(2);
    const auto factor = RandomFactor<T>(30, 3, random);
    const auto x = RandomQueries(3, random);
    const TileResult untouched;
    for (int n_lanes = 1; n_lanes <= kTileLanes; ++n_lanes) {
      CAPTURE(n_lanes);
      const TileResult got = Query(factor, x, n_lanes);
      for (int lane = RoundedUp<T>(n_lanes); lane < kTileLanes; ++lane) {
        CHECK(got.mean[lane] == untouched.mean[lane]);
        CHECK(got.variance[lane] == untouched.variance[lane]);
      }
    }
  });
}

TEST_CASE_TEMPLATE("gp_query: a lane's bits do not depend on its place or its neighbours", T,
                   double, float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(3);
    const auto factor = RandomFactor<T>(140, 6, random, true);
    const auto x = RandomQueries(6, random);
    const TileResult straight = Query(factor, x);
    for (const int shift : {1, 5, 23, 40}) {
      auto rotated = x;
      for (int k = 0; k < 6; ++k) {
        double* const row = rotated.data() + k * kTileLanes;
        std::rotate(row, row + shift, row + kTileLanes);
      }
      const TileResult turned = Query(factor, rotated);
      for (int lane = 0; lane < kTileLanes; ++lane) {
        CHECK(turned.mean[lane] == straight.mean[(lane + shift) % kTileLanes]);
        CHECK(turned.variance[lane] == straight.variance[(lane + shift) % kTileLanes]);
      }
    }
  });
}

}  // namespace
}  // namespace downpour
