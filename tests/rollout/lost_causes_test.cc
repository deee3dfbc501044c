// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/lost_causes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <random>
#include <vector>

#include "engine/errors.h"
#include "tests/rollout/swing_fixture.h"

namespace downpour {
namespace {

// Candidates of a group, best mean return first, ties by index; returns of `n_rollouts` each.
std::vector<int> Ranking(const std::vector<double>& returns, const std::vector<int>& n_rollouts,
                         int first, int n) {
  std::vector<double> means;
  auto value = returns.begin();
  for (const int r : n_rollouts) {
    means.push_back(std::accumulate(value, value + r, 0.0) / r);
    value += r;
  }
  std::vector<int> order(static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), first);
  std::sort(order.begin(), order.end(),
            [&](int a, int b) { return means[a] != means[b] ? means[a] > means[b] : a < b; });
  return order;
}

// Checks that the n_exact best of every group, their order and their returns are those of `full`,
// and that a return which differs is no larger. Returns how many returns differ.
int CheckExact(const std::vector<CandidateGroup>& groups, const std::vector<int>& n_rollouts,
               const std::vector<double>& full, const std::vector<double>& stopped) {
  std::vector<int> first_return(n_rollouts.size());
  std::exclusive_scan(n_rollouts.begin(), n_rollouts.end(), first_return.begin(), 0);
  int first = 0;
  for (const CandidateGroup& group : groups) {
    const auto want = Ranking(full, n_rollouts, first, group.n_candidates);
    const auto got = Ranking(stopped, n_rollouts, first, group.n_candidates);
    for (int k = 0; k < std::min(group.n_exact, group.n_candidates); ++k) {
      REQUIRE(got[k] == want[k]);
      for (int r = 0; r < n_rollouts[want[k]]; ++r) {
        REQUIRE(stopped[first_return[want[k]] + r] == full[first_return[want[k]] + r]);
      }
    }
    first += group.n_candidates;
  }
  int differ = 0;
  for (std::size_t k = 0; k < full.size(); ++k) differ += stopped[k] != full[k];
  return differ;
}

// A random generation: groups of different sizes, rollouts whose rewards begin and may end at
// random steps, some of which diverge.
struct Generation {
  Generation(std::mt19937* random, int horizon) : horizon(horizon) {
    const auto below = [&](int n) { return static_cast<int>((*random)() % n); };
    const int n_groups = 1 + below(4), chance_of_divergence = 1 + below(30);
    for (int g = 0; g < n_groups; ++g) {
      const int n = 1 + below(20);
      groups.push_back({n, 1 + below(n + 1)});  // n_exact may be more than there are
    }
    int n_candidates = 0;
    for (const CandidateGroup& group : groups) n_candidates += group.n_candidates;
    for (int c = 0; c < n_candidates; ++c) {
      n_rollouts.push_back(1 + below(3));
      for (int r = 0; r < n_rollouts.back(); ++r) {
        const int begin = below(horizon), end = below(3) == 0 ? below(horizon) : horizon;
        // Equal rewards make ties.
        const double reward = 0.25 * (1 + below(4));
        for (int t = 0; t < horizon; ++t) rewards.push_back(t >= begin && t < end ? reward : 0);
        diverges.push_back(below(chance_of_divergence) == 0 ? below(horizon) : horizon);
      }
    }
  }

  // Of rollout k up to a step.
  double Return(std::size_t k, int step) const {
    if (diverges[k] < step) return -horizon;
    const auto begin = rewards.begin() + static_cast<std::ptrdiff_t>(k * horizon);
    return std::accumulate(begin, begin + step, 0.0);
  }

  int horizon;
  std::vector<CandidateGroup> groups;
  std::vector<int> n_rollouts;
  std::vector<double> rewards;  // a row a rollout
  std::vector<int> diverges;    // step at which a rollout does; horizon: never
};

TEST_CASE("lost_causes: the best of every group are exact for any rewards and divergence") {
  std::mt19937 random(1);
  LostCauses lost_causes;
  std::int64_t computed = 0, all = 0;
  int differ = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    const Generation g(&random, 1 + static_cast<int>(random() % 50));
    const std::size_t n = g.diverges.size();
    std::vector<int> reached(n, 0), first_return(g.n_rollouts.size());
    std::exclusive_scan(g.n_rollouts.begin(), g.n_rollouts.end(), first_return.begin(), 0);
    std::vector<double> full(n), returns(n);
    for (std::size_t k = 0; k < n; ++k) full[k] = g.Return(k, g.horizon);
    lost_causes.Start(g.groups, g.n_rollouts, g.horizon);
    for (;;) {
      const RolloutLeg leg = lost_causes.Next(returns);
      if (leg.candidates.empty()) break;
      REQUIRE(leg.begin < leg.end);
      REQUIRE(std::is_sorted(leg.candidates.begin(), leg.candidates.end()));
      for (const int c : leg.candidates) {
        for (int k = first_return[c]; k < first_return[c] + g.n_rollouts[c]; ++k) {
          REQUIRE(reached[k] == leg.begin);
          reached[k] = leg.end;
          computed += leg.end - leg.begin;
          returns[k] = g.Return(static_cast<std::size_t>(k), leg.end);
        }
      }
    }
    all += static_cast<std::int64_t>(n) * g.horizon;
    for (std::size_t k = 0; k < n; ++k) {
      if (returns[k] != full[k]) REQUIRE(reached[k] < g.horizon);
    }
    differ += CheckExact(g.groups, g.n_rollouts, full, returns);
  }
  CHECK(differ > 1000);
  CHECK(computed < 0.97 * static_cast<double>(all));
}

TEST_CASE("lost_causes: a candidate that may still tie with the last of the best runs on") {
  // Steps 7, 8 and 9 are left; the leader ends with 7 as the others' bounds say: 4 + 3.
  const std::vector<CandidateGroup> groups = {{3, 1}};
  const std::vector<int> one(3, 1);
  LostCauses lost_causes;
  lost_causes.Start(groups, one, 10);
  CHECK(lost_causes.Next({}).end == 7);
  std::vector<double> returns = {7, 4, 4 - 1e-12};
  CHECK(lost_causes.Next(returns).candidates.front() == 0);
  const RolloutLeg leg = lost_causes.Next(returns);
  REQUIRE(leg.candidates.size() == 1);
  CHECK(leg.candidates[0] == 1);
}

TEST_CASE("lost_causes: groups that do not cover the batch are refused") {
  const std::vector<int> one(3, 1), none = {1, 0, 1};
  LostCauses lost_causes;
  const auto start = [&](std::vector<CandidateGroup> groups, const std::vector<int>& n_rollouts) {
    lost_causes.Start(groups, n_rollouts, 10);
  };
  CHECK_NOTHROW(start({{2, 1}, {1, 1}}, one));
  CHECK_THROWS_AS(start({{2, 1}}, one), InvalidInput);
  CHECK_THROWS_AS(start({{4, 1}}, one), InvalidInput);
  CHECK_THROWS_AS(start({{3, 0}}, one), InvalidInput);
  CHECK_THROWS_AS(start({{0, 1}, {3, 1}}, one), InvalidInput);
  CHECK_THROWS_AS(start({{3, 1}}, none), InvalidInput);
}

constexpr int kHorizon = 30;

// A mass that is to stay where it hangs: who does not is soon lost.
Fixture Hanging(QueryBackend backend = QueryBackend::kFused) {
  Fixture f(kHorizon, 30, backend);
  f.task.reward = MakeSaturatingReward(f.task.feature_names, {0, 1, 0, 0, 0, 1}, {1, 0}, 0.2);
  return f;
}

// Groups of different sizes and n_exact, and 1 to 3 rollouts.
const std::vector<CandidateGroup> kGroups = {{40, 21}, {7, 2}, {25, 5}, {1, 1}, {36, 19}};
constexpr int kCandidates = 40 + 7 + 25 + 1 + 36;

std::vector<double> Returns(Fixture* f, int threads, const std::vector<CandidateGroup>& groups,
                            bool relaxed = false) {
  std::vector<double> theta(kCandidates * f->policy->n_parameters());
  FillNormals({2, 2}, 0, theta.data(), theta.size());
  std::vector<StreamKey> keys;
  std::vector<int> n_rollouts, first;
  for (std::uint32_t c = 0; c < kCandidates; ++c) {
    keys.push_back(DeriveKey(7, StreamPurpose::kRollout, {c}));
    n_rollouts.push_back(1 + static_cast<int>(c % 3));
    first.push_back(static_cast<int>(c % 5));
  }
  EvaluatorOptions options;
  options.threads = threads;
  Evaluator evaluator(f->task, *f->policy, f->factors, options);
  std::vector<double> returns(std::accumulate(n_rollouts.begin(), n_rollouts.end(), 0));
  evaluator.Evaluate(theta, keys, n_rollouts, first, returns, groups, relaxed);
  f->statistics = evaluator.statistics();
  return returns;
}

std::vector<int> RolloutCounts() {
  std::vector<int> counts(kCandidates);
  for (int c = 0; c < kCandidates; ++c) counts[c] = 1 + c % 3;
  return counts;
}

TEST_CASE("evaluator: stopping lost causes leaves the best of each group their bits") {
  for (const bool diverging : {false, true}) {
    Fixture f = Hanging();
    if (diverging) {
      for (double& weight : std::get<GpFactor>(f.factors[0]).weights) weight *= 1e5;
    }
    const auto full = Returns(&f, 1, {});
    const EvaluatorStatistics all = f.statistics;
    const auto stopped = Returns(&f, 1, kGroups);
    CHECK((all.diverged > 0) == diverging);
    CHECK(CheckExact(kGroups, RolloutCounts(), full, stopped) >= 5);
    CHECK(f.statistics.steps < 0.99 * static_cast<double>(all.steps));
    CHECK(f.statistics.lane_steps < all.lane_steps);
    const auto full_relaxed = Returns(&f, 1, {}, true);
    CHECK(full_relaxed != full);
    CHECK(CheckExact(kGroups, RolloutCounts(), full_relaxed, Returns(&f, 1, kGroups, true)) > 0);
  }
}

TEST_CASE("evaluator: with lost causes stopped the bits do not depend on the number of threads") {
  std::int64_t steps = 0;
  for (const QueryBackend backend : {QueryBackend::kFused, QueryBackend::kBlas}) {
    Fixture f = Hanging(backend);
    const auto one = Returns(&f, 1, kGroups);
    const EvaluatorStatistics statistics = f.statistics;
    if (steps == 0) steps = statistics.steps;
    CHECK(statistics.steps == steps);  // the same ones are lost with OpenBLAS
    for (const int threads : {2, 5}) {
      CHECK(Returns(&f, threads, kGroups) == one);
      CHECK(f.statistics.steps == statistics.steps);
      CHECK(f.statistics.lane_steps == statistics.lane_steps);
    }
  }
}

TEST_CASE("evaluator: a step of a rollout counts once, and only if it was computed") {
  Fixture f = Hanging();
  Returns(&f, 1, {});
  const std::int64_t n_rollouts = f.statistics.rollouts;
  CHECK(f.statistics.steps == n_rollouts * kHorizon);
  CHECK(f.statistics.gp_queries == 2 * f.statistics.steps);
  Returns(&f, 1, kGroups);
  CHECK(f.statistics.rollouts == n_rollouts);
  CHECK(f.statistics.gp_queries == 2 * f.statistics.steps);
  // All are best: nothing can be lost.
  Returns(&f, 1, {{kCandidates, kCandidates}});
  CHECK(f.statistics.steps == n_rollouts * kHorizon);
}

}  // namespace
}  // namespace downpour
