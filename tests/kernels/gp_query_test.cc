// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_query/gp_query.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "kernels/gp_query/gp_query_ref.h"
#include "tests/kernels/each_target.h"
#include "tests/kernels/gp_query_cases.h"

namespace downpour {
namespace {

// Largest error of mean and variance in units of their bounds, which gp_query.h states, over all
// lanes and targets.
template <typename T>
double WorstErrorOverBound(int n, int dim, TestNumbers& random, bool deflate = false) {
  const auto factor = RandomFactor<T>(n, dim, random, deflate);
  const auto x = RandomQueries(dim, random);
  std::vector<GpQueryReference> want;
  for (int lane = 0; lane < kTileLanes; ++lane) {
    want.push_back(QueryReference(factor, Lane(x, lane).data()));
  }
  const long double unit = (n + dim + 4) * std::numeric_limits<T>::epsilon();
  double worst = 0;
  ForEachTarget([&](const char*) {
    const TileResult got = Query(factor, x);
    for (int lane = 0; lane < kTileLanes; ++lane) {
      const GpQueryReference& w = want[lane];
      const long double mean = std::abs(got.mean[lane] - w.mean) / (unit * w.mean_absolute);
      const long double variance = std::abs(got.variance[lane] - std::max(w.variance, 0.0L)) /
                                   (unit * (factor.signal_variance + 2 * w.norm_absolute));
      // Written so that NaN counts as wrong.
      if (!(mean <= worst)) worst = static_cast<double>(mean);
      if (!(variance <= worst)) worst = static_cast<double>(variance);
    }
  });
  return worst;
}

TEST_CASE_TEMPLATE("gp_query: matches the long-double reference for every tail size", T, double,
                   float) {
  TestNumbers random(1);
  for (const int n : {1,  2,  7,   8,   9,   15,  16,  17,  24,  31,  40,  63,  64,
                      65, 80, 119, 120, 121, 127, 128, 129, 131, 136, 255, 257, 320}) {
    for (const int dim : {4, 5}) {
      CAPTURE(n);
      CAPTURE(dim);
      CHECK(WorstErrorOverBound<T>(n, dim, random) <= 1);
    }
  }
}

TEST_CASE_TEMPLATE("gp_query: matches the long-double reference for every dimension", T, double,
                   float) {
  TestNumbers random(2);
  for (int dim = 1; dim <= 64; ++dim) {
    CAPTURE(dim);
    CHECK(WorstErrorOverBound<T>(21, dim, random) <= 1);
  }
}

TEST_CASE_TEMPLATE("gp_query: a deflated factor matches the long-double reference", T, double,
                   float) {
  TestNumbers random(7);
  for (const int n : {8, 9, 15, 16, 17, 40, 127, 128, 129, 136, 200}) {
    CAPTURE(n);
    CHECK(WorstErrorOverBound<T>(n, 6, random, true) <= 1);
  }
}

// What a deflation does to the numbers of a factor does not change its posterior.
TEST_CASE("gp_query: a deflated factor stands for the same posterior") {
  for (const int n : {8, 9, 50, 131}) {
    CAPTURE(n);
    TestNumbers one(8), other(8), random(9);
    const auto plain = RandomFactor<double>(n, 5, one);
    const auto deflated = RandomFactor<double>(n, 5, other, true);
    REQUIRE(plain.triangle != deflated.triangle);
    const auto x = RandomQueries(5, random);
    for (int lane = 0; lane < kTileLanes; ++lane) {
      const GpQueryReference a = QueryReference(plain, Lane(x, lane).data());
      const GpQueryReference b = QueryReference(deflated, Lane(x, lane).data());
      // W' and w' are sums of n terms in double.
      const double unit = n * std::numeric_limits<double>::epsilon();
      CHECK(std::abs(a.mean - b.mean) <= unit * b.mean_absolute);
      CHECK(std::abs(a.variance - b.variance) <= 2 * unit * b.norm_absolute);
    }
  }
}

TEST_CASE_TEMPLATE("gp_query: a centre keeps the digits of inputs far from the origin", T, double,
                   float) {
  TestNumbers random(3);
  constexpr int kPoints = 30, kDim = 2;
  std::vector<double> inputs(kPoints * kDim), weights(kPoints), inverse(kPoints * kPoints);
  for (double& x : inputs) x = 1e6 + random();
  for (double& w : weights) w = random();
  for (double& w : inverse) w = random() / kPoints;
  const std::vector<double> lengthscales(kDim, 1.0);
  const auto factor = PackGpFactor<T>({.n = kPoints,
                                       .dim = kDim,
                                       .inputs = inputs.data(),
                                       .lengthscales = lengthscales.data(),
                                       .signal_std = 1,
                                       .noise_std = 0.1,
                                       .weights = weights.data(),
                                       .inverse_factor = inverse.data()});
  auto x = RandomQueries(kDim, random);
  for (double& v : x) v += 1e6;
  const TileResult got = Query(factor, x);
  for (int lane = 0; lane < kTileLanes; ++lane) {
    const auto query = Lane(x, lane);
    long double mean = 0, absolute = 0;
    for (int i = 0; i < kPoints; ++i) {
      long double exponent = 0;
      for (int k = 0; k < kDim; ++k) {
        const long double t = static_cast<long double>(query[k]) - inputs[i * kDim + k];
        exponent += t * t / 2;
      }
      mean += weights[i] * std::exp(-exponent);
      absolute += std::abs(weights[i]);
    }
    // 1e6 costs six digits of double; what remains is rounded to T about the centre.
    const double eps =
        1e6 * std::numeric_limits<double>::epsilon() + std::numeric_limits<T>::epsilon();
    CHECK(std::abs(got.mean[lane] - mean) <= 40 * eps * absolute);
  }
}

TEST_CASE_TEMPLATE("gp_query: mean only gives the same mean", T, double, float) {
  TestNumbers random(4);
  const auto factor = RandomFactor<T>(37, 6, random);
  const auto x = RandomQueries(6, random);
  const TileResult both = Query(factor, x);
  AlignedVector<unsigned char> scratch(GpQueryScratchBytes(factor));
  AlignedVector<double> mean(kTileLanes);
  GpQueryTile(factor, kTileLanes, x.data(), scratch.data(), mean.data(), nullptr);
  CHECK(mean == both.mean);
}

TEST_CASE_TEMPLATE("gp_query: a query that is not finite spoils its own lane only", T, double,
                   float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(5);
    const auto factor = RandomFactor<T>(20, 3, random);
    const auto x = RandomQueries(3, random);
    const TileResult clean = Query(factor, x);
    for (const double bad : {std::nan(""), HUGE_VAL, -HUGE_VAL}) {
      for (const int at : {0, 7, 20, 33, 47}) {
        auto spoilt_x = x;
        spoilt_x[kTileLanes + at] = bad;
        const TileResult alone = Query(factor, spoilt_x, 1);
        CHECK(std::isnan(alone.mean[0]) == (at == 0));
        CHECK(std::isnan(alone.variance[0]) == (at == 0));
        const TileResult spoilt = Query(factor, spoilt_x);
        for (int lane = 0; lane < kTileLanes; ++lane) {
          if (lane == at) {
            CHECK(std::isnan(spoilt.mean[lane]));
            CHECK(std::isnan(spoilt.variance[lane]));
          } else {
            CHECK(spoilt.mean[lane] == clean.mean[lane]);
            CHECK(spoilt.variance[lane] == clean.variance[lane]);
          }
        }
      }
    }
  });
}

TEST_CASE_TEMPLATE("gp_query: far from the data the prior comes back, rounded once", T, double,
                   float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(6);
    const auto factor = RandomFactor<T>(20, 3, random);
    for (const double far : {1e3, -1e6, 1e30}) {
      const TileResult got = Query(factor, AlignedVector<double>(3 * kTileLanes, far));
      for (int lane = 0; lane < kTileLanes; ++lane) {
        CHECK(got.mean[lane] == 0);
        CHECK(got.variance[lane] == static_cast<T>(factor.signal_variance));
      }
    }
  });
}

TEST_CASE_TEMPLATE("gp_query: a variance that cancels below zero is clamped to zero", T, double,
                   float) {
  const double zero = 0, one = 1, inverse = 2;  // |W e|^2 = 4 > 1
  const auto factor = PackGpFactor<T>({.n = 1,
                                       .dim = 1,
                                       .inputs = &zero,
                                       .lengthscales = &one,
                                       .signal_std = 1,
                                       .noise_std = 0.1,
                                       .weights = &one,
                                       .inverse_factor = &inverse});
  const TileResult got = Query(factor, AlignedVector<double>(kTileLanes, 0.0));
  for (const double variance : got.variance) CHECK(variance == 0);
}

}  // namespace
}  // namespace downpour
