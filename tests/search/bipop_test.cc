// SPDX-License-Identifier: Apache-2.0
#include "engine/search/bipop.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "kernels/philox/philox.h"

namespace downpour {
namespace {

constexpr int kLambda = 10;

// Uniform draws of one restart.
std::pair<double, double> Draws(std::uint32_t run) {
  double u[2];
  FillUniforms(DeriveKey(5, StreamPurpose::kSearchRestart, {run}), 0, u, 2);
  return {u[0], u[1]};
}

TEST_CASE("bipop: one run at a time is BIPOP as published") {
  RestartScheduler scheduler(RestartStrategy::kBipop, kLambda, 1 << 20, 2, 2);
  const RunPlan first = scheduler.First(0.5);
  CHECK(first.regime == Regime::kFirst);
  CHECK(first.population == kLambda);
  CHECK(first.sigma == 0.5);
  scheduler.Add(first, 12345);
  scheduler.End(first);

  std::int64_t large = 0, small = 12345;
  int newest_large = kLambda;
  for (std::uint32_t run = 1; run < 400; ++run) {
    const auto [u, v] = Draws(run);
    const RunPlan plan = scheduler.Next(u, v);
    CHECK(plan.run == static_cast<int>(run));
    if (plan.regime == Regime::kLarge) {
      CHECK(small >= large);
      if (newest_large < kLambda << 9) newest_large *= 2;
      CHECK(plan.population == newest_large);
      CHECK(plan.sigma == 2);
    } else {
      CHECK(plan.regime == Regime::kSmall);
      CHECK(small < large);
      CHECK(plan.population >= kLambda);
      CHECK(plan.population <= newest_large / 2);
      CHECK(plan.sigma <= 2);
      CHECK(plan.sigma > 0.02);
    }
    // Large runs take 100 generations; small ones take 60 or end with their share.
    std::int64_t used = 0;
    const int generations = plan.regime == Regime::kLarge ? 100 : 60;
    for (int g = 0; g < generations && !scheduler.IsExhausted(plan, used); ++g) {
      used += plan.population;
      scheduler.Add(plan, plan.population);
    }
    if (plan.regime == Regime::kSmall) CHECK(2 * (used - plan.population) <= large);
    (plan.regime == Regime::kLarge ? large : small) += used;
    scheduler.End(plan);
  }
  CHECK(newest_large == kLambda << 9);
}

TEST_CASE("bipop: small populations are drawn as the published power") {
  RestartScheduler scheduler(RestartStrategy::kBipop, kLambda, 1 << 20, 1, 1);
  for (int doublings = 1; doublings <= 4; ++doublings) {
    const RunPlan large = scheduler.Next(0, 0);
    CHECK(large.population == kLambda << doublings);
    scheduler.Add(large, 1000);
    scheduler.End(large);
    const RunPlan small = scheduler.Next(0.9, 0.5);
    CHECK(small.population ==
          static_cast<int>(kLambda * std::pow((1 << doublings) / 2.0, 0.9 * 0.9)));
    CHECK(small.sigma == doctest::Approx(std::pow(10.0, -0.5)));
    scheduler.Add(small, 1000);
    scheduler.End(small);
  }
}

TEST_CASE("bipop: runs that start together are divided among the regimes") {
  RestartScheduler scheduler(RestartStrategy::kBipop, kLambda, 1 << 20, 1, 1);
  scheduler.First(1);
  int large = 0, small = kLambda, n_large = 0;
  for (std::uint32_t run = 1; run < 32; ++run) {
    const auto [u, v] = Draws(run);
    const RunPlan plan = scheduler.Next(u, v);
    const bool expects_small = small < large;
    CHECK((plan.regime == Regime::kSmall) == expects_small);
    (expects_small ? small : large) += plan.population;
    n_large += !expects_small;
  }
  CHECK(n_large >= 3);
  CHECK(n_large <= 6);
}

TEST_CASE("bipop: a small run has no limit while a large one is under way") {
  RestartScheduler scheduler(RestartStrategy::kBipop, kLambda, 1 << 20, 1, 1);
  const RunPlan large = scheduler.Next(0, 0), small = scheduler.Next(0, 0);
  REQUIRE(small.regime == Regime::kSmall);
  scheduler.Add(large, 1000);
  CHECK_FALSE(scheduler.IsExhausted(small, 501));
  scheduler.End(large);
  CHECK(scheduler.IsExhausted(small, 501));
  CHECK_FALSE(scheduler.IsExhausted(small, 500));
}

TEST_CASE("bipop: the population never exceeds its limit") {
  RestartScheduler scheduler(RestartStrategy::kBipop, kLambda, 55, 1, 1);
  for (std::uint32_t run = 0; run < 100; ++run) {
    const auto [u, v] = Draws(run);
    const RunPlan plan = scheduler.Next(u, v);
    CHECK(plan.population <= 55);
    CHECK(plan.population >= kLambda);
    scheduler.Add(plan, 100);
    scheduler.End(plan);
  }
}

TEST_CASE("bipop: IPOP doubles the population of every restart, up to its limit") {
  RestartScheduler scheduler(RestartStrategy::kIpop, kLambda, kLambda << 12, 2, 2);
  CHECK(scheduler.First(0.5).population == kLambda);
  for (int run = 1; run < 16; ++run) {
    const RunPlan plan = scheduler.Next(0.5, 0.5);
    CHECK(plan.regime == Regime::kLarge);
    CHECK(plan.population == kLambda << std::min(run, 12));
    CHECK(plan.sigma == 2);
    scheduler.Add(plan, 1000);
    CHECK_FALSE(scheduler.IsExhausted(plan, 1000));
    scheduler.End(plan);
  }
}

TEST_CASE("bipop: a default population that is not whole is rounded down after doubling") {
  RestartScheduler scheduler(RestartStrategy::kIpop, 10.9, 100, 2, 2);
  CHECK(scheduler.First(2).population == 10);
  for (const int population : {21, 43, 87, 100, 100}) {
    CHECK(scheduler.Next(0.5, 0.5).population == population);
  }
}

TEST_CASE("bipop: only the single strategy has no restarts") {
  for (const RestartStrategy strategy :
       {RestartStrategy::kBipop, RestartStrategy::kSmall, RestartStrategy::kIpop}) {
    CHECK(RestartScheduler(strategy, kLambda, 100, 1, 1).restarts());
  }
  CHECK_FALSE(RestartScheduler(RestartStrategy::kSingle, kLambda, 100, 1, 1).restarts());
}

TEST_CASE("bipop: the small strategy keeps the population and draws sigma log-uniformly") {
  RestartScheduler scheduler(RestartStrategy::kSmall, kLambda, 1 << 20, 5, 1.3);
  for (std::uint32_t run = 0; run < 100; ++run) {
    const auto [u, v] = Draws(run);
    const RunPlan plan = scheduler.Next(u, v);
    CHECK(plan.regime == Regime::kSmall);
    CHECK(plan.population == kLambda);
    CHECK(plan.sigma == doctest::Approx(5 * std::pow(10.0, -1.3 * v)));
    CHECK_FALSE(scheduler.IsExhausted(plan, 1'000'000));
  }
}

}  // namespace
}  // namespace downpour
