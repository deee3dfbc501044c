// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

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

// The same numbers, or NaN in the same places.
bool SameBits(const double* a, const double* b, int count) {
  return std::equal(a, a + count, b, [](double p, double q) {
    return std::isnan(p) ? std::isnan(q)
                         : std::bit_cast<std::uint64_t>(p) == std::bit_cast<std::uint64_t>(q);
  });
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

// Up to three lanes have a way of their own: panels end differently with n, passes with D.
TEST_CASE_TEMPLATE("gp_query: a lane alone has the bits that it has in a full tile", T, double,
                   float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(4);
    for (const int n : {1, 8, 24, 33, 40, 64, 72, 104, 128, 129, 200, 300}) {
      for (const int dim : {1, 6, 13}) {
        CAPTURE(n);
        CAPTURE(dim);
        const auto factor = RandomFactor<T>(n, dim, random, n >= 8 && dim != 6);
        auto x = RandomQueries(dim, random);
        x[3] = std::nan("");
        x[5] = HUGE_VAL;
        x[7] = 1e3;
        const TileResult full = Query(factor, x);
        for (int lane = 0; lane + 2 < kTileLanes; ++lane) {
          AlignedVector<double> shifted(x.size(), std::nan(""));
          for (int k = 0; k < dim; ++k) {
            std::copy_n(x.data() + k * kTileLanes + lane, 3, shifted.data() + k * kTileLanes);
          }
          for (const int n_lanes : {1, 2, 3}) {
            const TileResult alone = Query(factor, shifted, n_lanes);
            CHECK(SameBits(alone.mean.data(), full.mean.data() + lane, n_lanes));
            CHECK(SameBits(alone.variance.data(), full.variance.data() + lane, n_lanes));
          }
        }
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
