// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels/gp_query/gp_query.h"
#include "tests/kernels/each_target.h"
#include "tests/kernels/gp_query_cases.h"

namespace downpour {
namespace {

// A factor whose mean is 2^-|x|^2 of `dim` inputs x, up to two, |x|^2 rounded to T.
template <typename T>
GpFactorT<T> PowerFactor(int dim = 1) {
  const double zero = 0, one = 1;
  const double zeros[] = {0, 0}, ones[] = {1, 1};
  auto factor = PackGpFactor<T>({.n = 1,
                                 .dim = dim,
                                 .inputs = zeros,
                                 .lengthscales = ones,
                                 .signal_std = 1,
                                 .noise_std = 1,
                                 .weights = &one,
                                 .inverse_factor = &zero});
  factor.scale.assign(dim, 1.0);
  return factor;
}

TEST_CASE_TEMPLATE("gp_query: the power is within 1.2 ulp over its whole range", T, double, float) {
  const auto factor = PowerFactor<T>();
  const double last = std::sqrt(1.0 - std::numeric_limits<T>::min_exponent);  // 2^-last^2 is normal
  TestNumbers random(1);
  double worst = 0;
  constexpr int kTiles = 1000;
  for (int tile = 0; tile < kTiles; ++tile) {
    AlignedVector<double> x(kTileLanes);
    for (int lane = 0; lane < kTileLanes; ++lane) {
      x[lane] = static_cast<T>(last * (tile + 0.5 + 0.5 * random()) / kTiles);
    }
    ForEachTarget([&](const char*) {
      const TileResult got = Query(factor, x);
      for (int lane = 0; lane < kTileLanes; ++lane) {
        const T s = static_cast<T>(x[lane]) * static_cast<T>(x[lane]);
        const long double want = std::exp2(-static_cast<long double>(s));
        const long double ulp =
            std::exp2(std::floor(std::log2(want))) * std::numeric_limits<T>::epsilon();
        worst = std::max(worst, static_cast<double>(std::abs(got.mean[lane] - want) / ulp));
      }
    });
  }
  CHECK(worst <= 1.2);
}

// Odd a and b make a^2 + b^2 twice an odd number: (a^2 + b^2)/64 lies between two sixteenths.
TEST_CASE_TEMPLATE("gp_query: the power is within 1.2 ulp half way between two table entries", T,
                   double, float) {
  const auto factor = PowerFactor<T>(2);
  const int last = static_cast<int>(8 * std::sqrt(1.0 - std::numeric_limits<T>::min_exponent));
  ForEachTarget([&](const char* target) {
    CAPTURE(target);
    for (int a = 1; a < last; a += 2) {
      AlignedVector<double> x(2 * kTileLanes, a / 8.0);
      for (int lane = 0; lane < kTileLanes; ++lane) x[kTileLanes + lane] = (2 * lane + 1) / 8.0;
      const TileResult got = Query(factor, x);
      for (int lane = 0; lane < kTileLanes; ++lane) {
        const int b = 2 * lane + 1;
        if (a * a + b * b > last * last) break;
        const long double want = std::exp2(-(a * a + b * b) / 64.0L);
        const long double ulp =
            std::exp2(std::floor(std::log2(want))) * std::numeric_limits<T>::epsilon();
        CHECK(std::abs(got.mean[lane] - want) <= 1.2L * ulp);
      }
    }
  });
}

TEST_CASE_TEMPLATE("gp_query: the power is exactly 1 at 0 and exactly 0 beyond its range", T,
                   double, float) {
  const auto factor = PowerFactor<T>();
  const double first_zero = 0.5 + 1 - std::numeric_limits<T>::min_exponent;
  ForEachTarget([&](const char* target) {
    CAPTURE(target);
    AlignedVector<double> x(kTileLanes);
    for (int lane = 1; lane < kTileLanes; ++lane) {
      x[lane] = std::sqrt(first_zero) * (1 + 1e-6) * std::exp(lane - 1.0);
    }
    const TileResult got = Query(factor, x);
    CHECK(got.mean[0] == 1);
    for (int lane = 1; lane < kTileLanes; ++lane) CHECK(got.mean[lane] == 0);
  });
}

}  // namespace
}  // namespace downpour
