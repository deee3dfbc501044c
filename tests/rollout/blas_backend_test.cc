// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "engine/gp/blas_query.h"
#include "tests/rollout/swing_fixture.h"

namespace downpour {
namespace {

constexpr int kHorizon = 6;
constexpr double kShift = 1e-7;

Fixture Shifted(int n_points = 30) {
  Fixture f(kHorizon, n_points);
  for (double& start : f.task.start_mean) start += kShift;
  return f;
}

// Largest difference of the backends' numbers in units of its bound. A step's rounding is that of a
// query's sums, (n + D + 4) eps, times signal / noise = 14 for their cancelling; in a rollout it
// grows as a shift of the start does, which is measured.
double Worst(const std::vector<double>& blas, const std::vector<double>& fused,
             const std::vector<double>& shifted, int n_points = 30) {
  REQUIRE(blas.size() == fused.size());
  double worst = 0;
  for (std::size_t i = 0; i < fused.size(); ++i) {
    const double growth = std::abs(shifted[i] - fused[i]) / kShift;
    const double bound =
        14 * (n_points + 4 + 4) * kHorizon * std::numeric_limits<double>::epsilon() * (1 + growth);
    const double difference = std::abs(blas[i] - fused[i]) / bound;
    if (!(difference <= worst)) worst = difference;  // NaN counts as wrong
  }
  return worst;
}

TEST_CASE("blas backend: the bits do not depend on the number of threads") {
  // 481 lanes: the last tile of the last block has one.
  Fixture f(10, 40, QueryBackend::kBlas);
  EvaluatorOptions options;
  const auto one = f.Returns(481, 1, options);
  for (const int threads : {2, 5}) {
    options.threads = threads;
    CHECK(f.Returns(481, 1, options) == one);
  }
}

TEST_CASE("blas backend: returns agree with the fused kernel's for every size") {
  for (const int n_points : {1, 7, 8, 9, 320}) {
    Fixture fused(kHorizon, n_points), blas(kHorizon, n_points, QueryBackend::kBlas);
    Fixture shifted = Shifted(n_points);
    for (const int lanes : {1, 47, 48, 49, 481}) {
      CAPTURE(n_points);
      CAPTURE(lanes);
      CHECK(Worst(blas.Returns(lanes, 1, {}), fused.Returns(lanes, 1, {}),
                  shifted.Returns(lanes, 1, {}), n_points) <= 1);
      CHECK(blas.statistics.lane_steps ==
            kHorizon * ((lanes + kTileLanes - 1) / kTileLanes * kTileLanes));
      // Whole vectors of eight doubles.
      CHECK(fused.statistics.lane_steps == kHorizon * ((lanes + 7) / 8 * 8));
    }
  }
}

TEST_CASE("blas backend: one output by BLAS beside one by the fused kernel") {
  Fixture fused(kHorizon), mixed(kHorizon), shifted = Shifted();
  mixed.factors[1] = Fixture(kHorizon, 30, QueryBackend::kBlas).factors[1];
  const auto want = fused.Returns(300, 1, {}), got = mixed.Returns(300, 1, {});
  CHECK(Worst(got, want, shifted.Returns(300, 1, {})) <= 1);
  CHECK(got != want);
}

TEST_CASE("blas backend: returns by means only agree with the fused kernel's") {
  EvaluatorOptions options;
  options.use_variance = false;
  Fixture fused(kHorizon), blas(kHorizon, 30, QueryBackend::kBlas), shifted = Shifted();
  CHECK(Worst(blas.Returns(100, 1, options), fused.Returns(100, 1, options),
              shifted.Returns(100, 1, options)) <= 1);
}

TEST_CASE("blas backend: inputs visited are those of their candidate and step") {
  const auto visited = [](Fixture f) {
    const std::uint32_t n = 250;  // two blocks
    std::vector<double> theta(n * f.policy->n_parameters());
    FillNormals({2, 2}, 0, theta.data(), theta.size());
    std::vector<StreamKey> keys;
    for (std::uint32_t c = 0; c < n; ++c) keys.push_back({c, 9});
    return Evaluator(f.task, *f.policy, f.factors, {})
        .Trace(theta, keys, std::vector<int>(n, 1))
        .inputs;
  };
  CHECK(Worst(visited(Fixture(kHorizon, 30, QueryBackend::kBlas)), visited(Fixture(kHorizon)),
              visited(Shifted())) <= 1);
}

TEST_CASE("blas backend: diverged rollouts get the penalty and are counted") {
  Fixture f(40, 30, QueryBackend::kBlas);
  auto& weights = std::get<BlasFactor>(f.factors[0]).weights;
  weights.assign(weights.size(), 1e7);
  const auto returns = f.Returns(100, 1, {});
  for (const double r : returns) CHECK(std::isfinite(r));
  CHECK(f.statistics.diverged > 0);
  CHECK(f.statistics.diverged == std::count(returns.begin(), returns.end(), -40.0));
}

}  // namespace
}  // namespace downpour
