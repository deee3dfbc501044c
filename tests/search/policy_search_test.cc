// SPDX-License-Identifier: Apache-2.0
#include "engine/search/policy_search.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "engine/search/final_comparison.h"
#include "tests/search/noisy_search.h"

namespace downpour {
namespace {

// Without selection between the runs.
PolicySearchOptions EqualOptions() {
  PolicySearchOptions options = SmallOptions();
  options.exploration = 1;
  return options;
}

TEST_CASE("policy_search: finds the optimum of a noisy function") {
  for (const RestartStrategy restarts : {RestartStrategy::kBipop, RestartStrategy::kSmall,
                                         RestartStrategy::kIpop, RestartStrategy::kSingle}) {
    for (const UncertaintyHandling uncertainty :
         {UncertaintyHandling::kOff, UncertaintyHandling::kSigma, UncertaintyHandling::kRollouts}) {
      PolicySearchOptions options = SmallOptions();
      options.restarts = restarts;
      options.uncertainty = uncertainty;
      const PolicySearchResult result = Search(options, Noisy(Hill, 1));
      CHECK(Hill(result.parameters) > 39.5);
      // The estimate takes 266 rollouts here: standard error 0.06.
      CHECK(std::abs(result.predicted_return - Hill(result.parameters)) < 0.3);
    }
  }
}

TEST_CASE("policy_search: reaches an optimum on the bounds and never leaves them") {
  const auto linear = [](std::span<const double> x) {
    for (const double v : x) CHECK(std::abs(v) <= 2);
    return std::accumulate(x.begin(), x.end(), 0.0);
  };
  PolicySearchOptions options = SmallOptions();
  options.bound = 2;
  const PolicySearchResult result = Search(options, Noisy(linear, 0));
  for (const double value : result.parameters) CHECK(value > 1.99);
}

TEST_CASE("policy_search: bits depend on seed and episode, not on the order of evaluation") {
  const auto run = [](bool reverse, std::uint64_t seed, std::uint32_t episode) {
    return SearchPolicy(SmallOptions(), std::vector<double>(kP, 0.0), seed, episode,
                        Noisy(Hill, 1, nullptr, reverse), {}, nullptr);
  };
  const PolicySearchResult expected = run(false, 1, 1), result = run(true, 1, 1);
  CHECK(result.parameters == expected.parameters);
  CHECK(result.predicted_return == expected.predicted_return);
  REQUIRE(result.runs.size() == expected.runs.size());
  for (std::size_t k = 0; k < result.runs.size(); ++k) {
    CHECK(result.runs[k].mean_return == expected.runs[k].mean_return);
    CHECK(result.runs[k].stop == expected.runs[k].stop);
  }
  CHECK(run(false, 0, 1).parameters != expected.parameters);
  CHECK(run(false, 1, 2).parameters != expected.parameters);
}

TEST_CASE("policy_search: the bits do not depend on the number of threads") {
  PolicySearchOptions options = SmallOptions();
  options.concurrent = 7;
  const PolicySearchResult one = Search(options, Noisy(Hill, 1));
  for (const int threads : {2, 5}) {
    options.threads = threads;
    const PolicySearchResult many = Search(options, Noisy(Hill, 1));
    CHECK(many.parameters == one.parameters);
    CHECK(many.predicted_return == one.predicted_return);
  }
}

TEST_CASE("policy_search: threads with objectives of their own change nothing but who evaluates") {
  PolicySearchOptions options = SmallOptions();
  options.concurrent = 7;
  std::int64_t expected_rollouts = 0;
  const PolicySearchResult expected = Search(options, Noisy(Hill, 1, &expected_rollouts));
  for (const std::size_t threads : {2, 3, 4, 5, 6, 7}) {
    options.threads = static_cast<int>(threads);
    // Each counts for itself, as only one thread may call it at a time.
    std::vector<std::int64_t> rollouts(threads, 0);
    std::vector<std::atomic<int>> inside(threads);
    std::atomic<bool> shared = false;
    std::vector<BatchObjective> own;
    for (std::size_t t = 0; t < threads; ++t) {
      own.push_back([&, t, noisy = Noisy(Hill, 1, &rollouts[t])](const CandidateBatch& batch,
                                                                 std::span<double> returns) {
        if (++inside[t] != 1) shared = true;
        noisy(batch, returns);
        --inside[t];
      });
    }
    double waiting = -1;
    std::int64_t together = 0;
    const PolicySearchResult result = SearchPolicy(
        options, std::vector<double>(kP, 0.0), 1, 2, Noisy(Hill, 1, &together),
        [&](const PolicySearchProgress& now) {
          CHECK(now.waiting_seconds >= waiting);
          waiting = now.waiting_seconds;
        },
        nullptr, own);
    CHECK_FALSE(shared);
    CHECK(result.parameters == expected.parameters);
    CHECK(result.predicted_return == expected.predicted_return);
    CHECK(result.evaluations == expected.evaluations);
    REQUIRE(result.runs.size() == expected.runs.size());
    for (std::size_t k = 0; k < result.runs.size(); ++k) {
      CHECK(result.runs[k].evaluations == expected.runs[k].evaluations);
      CHECK(result.runs[k].stop == expected.runs[k].stop);
    }
    // Six runs explore, what the budget holds; seven threads have none for all of them. A thread
    // that is late may find nothing left.
    const std::int64_t own_rollouts = std::accumulate(rollouts.begin(), rollouts.end(), 0L);
    CHECK((own_rollouts > 0) == (threads < 7));
    CHECK((waiting > 0) == (threads < 7));
    CHECK(own_rollouts + together == expected_rollouts);
  }
}

TEST_CASE("policy_search: what an objective of one thread throws arrives") {
  PolicySearchOptions options = SmallOptions();
  options.threads = 2;
  const std::vector<BatchObjective> own(
      2, [](const CandidateBatch&, std::span<double>) { throw InvalidInput("own"); });
  CHECK_THROWS_WITH_AS(
      SearchPolicy(options, std::vector<double>(kP, 0.0), 1, 2, Noisy(Hill, 1), {}, nullptr, own),
      "own", InvalidInput);
}

TEST_CASE("policy_search: spends no more than its budget and accounts for every rollout") {
  for (const std::int64_t evaluations : {1000, 3000, 20000}) {
    for (const int rollouts : {1, 3}) {
      for (const UncertaintyHandling uncertainty :
           {UncertaintyHandling::kOff, UncertaintyHandling::kRollouts}) {
        PolicySearchOptions options = EqualOptions();
        options.evaluations = evaluations;
        options.rollouts = rollouts;
        options.uncertainty = uncertainty;
        std::int64_t used = 0;
        const PolicySearchResult result = Search(options, Noisy(Hill, 1, &used));
        CHECK(result.evaluations == used);
        CHECK(used <= evaluations);
        CHECK(used > 0.7 * static_cast<double>(evaluations));
        const int final_rollouts = static_cast<int>(std::min<std::int64_t>(480, evaluations / 45));
        std::int64_t sum =
            FinalComparisonCost(static_cast<int>(result.runs.size()) + 1, final_rollouts) +
            final_rollouts;
        for (const RunRecord& run : result.runs) {
          CHECK(run.evaluations > 0);
          CHECK_FALSE(run.stop.empty());
          sum += run.evaluations;
        }
        CHECK(sum == used);
      }
    }
  }
}

TEST_CASE(
    "policy_search: the first run starts at the last policy, the others by the restart rule") {
  PolicySearchOptions options = EqualOptions();
  options.evaluations = 40000;
  options.first_sigma = 0.25;
  options.local_share = 0;
  options.population = 0;
  options.restarts = RestartStrategy::kBipop;
  const PolicySearchResult result = Search(options, Noisy(Hill, 1));
  REQUIRE(result.runs.size() > 4);
  CHECK(result.runs[0].initial_sigma == 0.25);
  CHECK(result.runs[0].population == 4 + static_cast<int>(3 * std::log(kP)));
  bool any_large = false, any_small = false;
  for (std::size_t k = 1; k < result.runs.size(); ++k) {
    const RunRecord& run = result.runs[k];
    CHECK(run.run == static_cast<int>(k));
    CHECK(run.initial_sigma <= options.restart_sigma);
    CHECK(run.initial_sigma >= options.restart_sigma * std::pow(10, -options.restart_decades));
    (run.large ? any_large : any_small) = true;
  }
  CHECK(any_large);
  CHECK(any_small);
}

TEST_CASE("policy_search: never returns less than the last policy is predicted to give") {
  // A needle at the start, too narrow for any run to hold.
  const std::vector<double> start(kP, 0.5);
  const auto needle = [&](std::span<const double> x) {
    return std::equal(x.begin(), x.end(), start.begin()) ? 10.0 : 0.0;
  };
  const PolicySearchResult result =
      SearchPolicy(SmallOptions(), start, 1, 1, Noisy(needle, 1), {}, nullptr);
  CHECK(result.parameters == start);
  CHECK(result.predicted_return == doctest::Approx(10).epsilon(0.05));
}

TEST_CASE("policy_search: every evaluation but the final comparison has its own stream") {
  std::set<std::tuple<std::uint32_t, std::uint32_t>> seen;
  int repeated_parameters = 0;
  for (const std::uint32_t episode : {1u, 2u}) {
    bool comparing = false;
    const BatchObjective inner = Noisy(Hill, 1);
    const auto check = [&](const CandidateBatch& batch, std::span<double> returns) {
      inner(batch, returns);
      comparing = comparing || batch.n_rollouts[0] > 1;
      std::set<std::vector<double>> parameters;
      for (std::size_t c = 0; c < static_cast<std::size_t>(batch.n_candidates); ++c) {
        if (comparing) {
          CHECK(batch.keys[c] == batch.keys[0]);
          continue;
        }
        CHECK(seen.emplace(batch.keys[c].word0, batch.keys[c].word1).second);
        const auto row = batch.parameters.subspan(c * kP, kP);
        repeated_parameters += !parameters.emplace(row.begin(), row.end()).second;
      }
    };
    PolicySearchOptions options = EqualOptions();
    options.uncertainty = UncertaintyHandling::kSigma;
    SearchPolicy(options, std::vector<double>(kP, 0.0), 1, episode, check, {}, nullptr);
    CHECK(comparing);
  }
  CHECK(repeated_parameters > 0);  // re-evaluations
}

TEST_CASE("policy_search: common random numbers are those of a generation or of the search") {
  for (const auto common : {CommonRandomNumbers::kGeneration, CommonRandomNumbers::kSearch}) {
    PolicySearchOptions options = EqualOptions();
    options.concurrent = 2;
    options.population = 10;
    options.common_random_numbers = common;
    std::set<std::tuple<std::uint32_t, std::uint32_t>> seen;
    std::size_t generations = 0;  // of both runs together
    bool comparing = false;
    const BatchObjective inner = Noisy(Hill, 1);
    Search(options, [&](const CandidateBatch& batch, std::span<double> returns) {
      inner(batch, returns);
      comparing = comparing || batch.n_rollouts[0] > 1;
      if (comparing) return;
      const auto n = static_cast<std::size_t>(batch.n_candidates);
      REQUIRE((n == 10 || n == 20));
      generations += n / 10;
      for (std::size_t c = 0; c < n; ++c) {
        CHECK(batch.keys[c] == batch.keys[c / 10 * 10]);
        seen.emplace(batch.keys[c].word0, batch.keys[c].word1);
      }
    });
    CHECK(generations > 200);
    const bool one = common == CommonRandomNumbers::kSearch;
    CHECK(seen.size() == (one ? 1 : generations));
  }
}

TEST_CASE("policy_search: rollouts rise to their limit where the ranking is noise") {
  PolicySearchOptions options = SmallOptions();
  options.uncertainty = UncertaintyHandling::kRollouts;
  options.max_rollouts = 7;
  options.concurrent = 1;
  int most = 0;
  const BatchObjective inner = Noisy([](auto) { return 0.0; }, 1);
  Search(options, [&](const CandidateBatch& batch, std::span<double> returns) {
    inner(batch, returns);
    if (batch.n_candidates > 16) most = std::max(most, batch.n_rollouts[0]);
  });
  CHECK(most == 7);
}

TEST_CASE("policy_search: returns that are not finite lose") {
  const auto broken = [](std::span<const double> x) {
    if (x[0] < 0) return std::numeric_limits<double>::quiet_NaN();
    if (x[1] > 0) return std::numeric_limits<double>::infinity();
    if (x[1] < -4) return -std::numeric_limits<double>::infinity();
    return Hill(x);
  };
  const PolicySearchResult result = Search(SmallOptions(), Noisy(broken, 0.1));
  CHECK(Hill(result.parameters) > 39);
}

TEST_CASE("policy_search: a stop is seen before the next batch") {
  std::atomic<bool> stop = false;
  int batches = 0;
  const auto progress = [&](const PolicySearchProgress& now) {
    CHECK(now.budget == 12000);
    CHECK(now.evaluations > 0);
    CHECK(now.runs_started >= 4);
    CHECK(now.best_return >= now.mean_return);
    stop = ++batches == 3;
  };
  CHECK_THROWS_AS(SearchPolicy(SmallOptions(), std::vector<double>(kP, 0.0), 1, 1, Noisy(Hill, 1),
                               progress, &stop),
                  Interrupted);
  CHECK(batches == 3);
}

TEST_CASE("policy_search: options out of range are refused by name") {
  const auto refused = [](const char* name, auto&& change) {
    PolicySearchOptions options = SmallOptions();
    change(options);
    std::string message;
    try {
      Search(options, Noisy(Hill, 1));
    } catch (const InvalidInput& error) {
      message = error.what();
    }
    CAPTURE(message);
    CHECK(message.starts_with(std::string("search.") + name + " = "));
    CHECK(message.find("must be ") != std::string::npos);
    CHECK(message.find('\n') == std::string::npos);
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  refused("evaluations", [](auto& o) { o.evaluations = 99; });
  refused("evaluations", [](auto& o) { o.evaluations = 2'000'000'000'000; });
  refused("evaluations", [](auto& o) { o.evaluations = 200, o.rollouts = 100; });
  refused("population", [](auto& o) { o.population = -1; });
  refused("population", [](auto& o) { o.population = 1; });
  refused("population", [](auto& o) { o.population = 100001; });
  refused("rollouts", [](auto& o) { o.rollouts = 0; });
  refused("max_rollouts", [](auto& o) { o.max_rollouts = 0; });
  refused("max_rollouts", [](auto& o) {
    o.uncertainty = UncertaintyHandling::kRollouts, o.rollouts = 5, o.max_rollouts = 4;
  });
  refused("concurrent", [](auto& o) { o.concurrent = 0; });
  refused("concurrent", [](auto& o) { o.concurrent = 1025; });
  refused("final_rollouts", [](auto& o) { o.final_rollouts = 0; });
  refused("bound", [&](auto& o) { o.bound = nan; });
  refused("bound", [&](auto& o) { o.bound = infinity; });
  refused("first_sigma", [](auto& o) { o.first_sigma = 0; });
  refused("restart_sigma", [](auto& o) { o.restart_sigma = -1; });
  refused("restart_decades", [](auto& o) { o.restart_decades = 11; });
  refused("restart_decades", [&](auto& o) { o.restart_decades = nan; });
  for (const auto reevaluates : {UncertaintyHandling::kSigma, UncertaintyHandling::kRollouts}) {
    refused("stop_lost_causes",
            [&](auto& o) { o.stop_lost_causes = true, o.uncertainty = reevaluates; });
  }
  CHECK_THROWS_AS(SearchPolicy(SmallOptions(), {}, 1, 1, Noisy(Hill, 1), {}, nullptr),
                  InvalidInput);
  CHECK_THROWS_AS(
      SearchPolicy(SmallOptions(), std::vector<double>{nan}, 1, 1, Noisy(Hill, 1), {}, nullptr),
      InvalidInput);
}

}  // namespace
}  // namespace downpour
