// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_query/gp_query.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "kernels/gp_query/gp_query_ref.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// A factor with arbitrary lower-triangular W of a size that makes |W e|^2 of order one.
GpFactor RandomFactor(int n, int dim, TestNumbers& random) {
  std::vector<double> inputs(n * dim), lengthscales(dim), weights(n), inverse(n * n);
  for (double& x : inputs) x = 2 * random();
  for (double& l : lengthscales) l = 1.5 + random();
  for (double& w : weights) w = random();
  for (double& w : inverse) w = random() / n;
  return PackGpFactor(n, dim, inputs.data(), lengthscales.data(), 1.3, 0.1, weights.data(),
                      inverse.data());
}

AlignedVector<double> RandomQueries(int dim, TestNumbers& random) {
  AlignedVector<double> x(dim * kTileLanes);
  for (double& v : x) v = 2 * random();
  return x;
}

struct Result {
  AlignedVector<double> mean = AlignedVector<double>(kTileLanes);
  AlignedVector<double> variance = AlignedVector<double>(kTileLanes);
};

Result Query(const GpFactor& factor, const AlignedVector<double>& x) {
  Result out;
  AlignedVector<double> scratch(GpQueryScratchSize(factor), std::nan(""));
  GpQueryTile(factor, x.data(), scratch.data(), out.mean.data(), out.variance.data());
  return out;
}

TEST_CASE("gp_query: matches the long-double reference for every size, dimension and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(1);
    for (const int n : {1, 2, 7, 8, 9, 15, 16, 17, 24, 40, 63, 64, 65, 131}) {
      for (const int dim : {1, 2, 4, 6, 12, 33}) {
        CAPTURE(n);
        CAPTURE(dim);
        const GpFactor factor = RandomFactor(n, dim, random);
        const auto x = RandomQueries(dim, random);
        const Result got = Query(factor, x);
        for (int lane = 0; lane < kTileLanes; ++lane) {
          std::vector<double> query(dim);
          for (int k = 0; k < dim; ++k) query[k] = x[k * kTileLanes + lane];
          const GpQueryReference want = QueryReference(factor, query.data());
          // Summation of n terms, exponent of D terms (each carries its relative error into e),
          // exp within 1 ulp.
          const long double unit = (n + dim + 4) * kEps;
          CHECK(std::abs(got.mean[lane] - want.mean) <= unit * want.mean_absolute);
          const long double variance = std::max(want.variance, 0.0L);
          CHECK(std::abs(got.variance[lane] - variance) <=
                unit * (factor.signal_variance + 2 * want.norm_absolute));
        }
      }
    }
  });
}

TEST_CASE("gp_query: mean only gives the same mean") {
  TestNumbers random(2);
  const GpFactor factor = RandomFactor(37, 6, random);
  const auto x = RandomQueries(6, random);
  const Result both = Query(factor, x);
  AlignedVector<double> scratch(GpQueryScratchSize(factor)), mean(kTileLanes);
  GpQueryTile(factor, x.data(), scratch.data(), mean.data(), nullptr);
  CHECK(mean == both.mean);
}

TEST_CASE("gp_query: a lane's bits do not depend on its place or its neighbours") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(3);
    const GpFactor factor = RandomFactor(50, 6, random);
    const auto x = RandomQueries(6, random);
    const Result straight = Query(factor, x);
    auto rotated = x;
    for (int k = 0; k < 6; ++k) {
      std::rotate(&rotated[k * kTileLanes], &rotated[k * kTileLanes] + 5,
                  &rotated[k * kTileLanes] + kTileLanes);
    }
    const Result turned = Query(factor, rotated);
    for (int lane = 0; lane < kTileLanes; ++lane) {
      CHECK(turned.mean[lane] == straight.mean[(lane + 5) % kTileLanes]);
      CHECK(turned.variance[lane] == straight.variance[(lane + 5) % kTileLanes]);
    }
  });
}

TEST_CASE("gp_query: a query that is not finite spoils its own lane only") {
  TestNumbers random(4);
  const GpFactor factor = RandomFactor(20, 3, random);
  auto x = RandomQueries(3, random);
  const Result clean = Query(factor, x);
  x[kTileLanes + 7] = std::nan("");
  const Result spoilt = Query(factor, x);
  for (int lane = 0; lane < kTileLanes; ++lane) {
    if (lane == 7) {
      CHECK(std::isnan(spoilt.mean[lane]));
      CHECK(std::isnan(spoilt.variance[lane]));
    } else {
      CHECK(spoilt.mean[lane] == clean.mean[lane]);
      CHECK(spoilt.variance[lane] == clean.variance[lane]);
    }
  }
}

TEST_CASE("gp_query: far from the data the prior comes back exactly") {
  TestNumbers random(5);
  const GpFactor factor = RandomFactor(20, 3, random);
  AlignedVector<double> x(3 * kTileLanes, 1e6);
  const Result got = Query(factor, x);
  for (int lane = 0; lane < kTileLanes; ++lane) {
    CHECK(got.mean[lane] == 0);
    CHECK(got.variance[lane] == factor.signal_variance);
  }
}

TEST_CASE("gp_query: a variance that cancels below zero is clamped to zero") {
  const double input = 0, lengthscale = 1, weight = 1, inverse = 2;  // |W e|^2 = 4 > 1
  const GpFactor factor = PackGpFactor(1, 1, &input, &lengthscale, 1.0, 0.1, &weight, &inverse);
  const Result got = Query(factor, AlignedVector<double>(kTileLanes, 0.0));
  for (const double variance : got.variance) CHECK(variance == 0);
}

}  // namespace
}  // namespace downpour
