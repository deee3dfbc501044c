// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/rollout_parts.h"

#include <doctest/doctest.h>

#include <numeric>
#include <vector>

#include "tests/rollout/swing_fixture.h"

namespace downpour {
namespace {

struct Outcome {
  std::vector<double> returns;
  EvaluatorStatistics statistics;
};

// 300 candidates' rollouts, with clocks or without.
Outcome Run(const Fixture& f, int threads, bool time_parts, bool use_variance = true) {
  constexpr int kCandidates = 300;
  std::vector<double> theta(static_cast<std::size_t>(kCandidates) * f.policy->n_parameters());
  FillNormals({2, 2}, 0, theta.data(), theta.size());
  const std::vector<StreamKey> keys(kCandidates, StreamKey{3, 4});
  std::vector<int> n_rollouts(kCandidates, 1), first(kCandidates);
  std::iota(first.begin(), first.end(), 0);
  Outcome outcome{std::vector<double>(kCandidates), {}};
  Evaluator evaluator(f.task, *f.policy, f.factors,
                      {.use_variance = use_variance, .threads = threads});
  if (time_parts) evaluator.TimeParts();
  evaluator.Evaluate(theta, keys, n_rollouts, first, outcome.returns);
  outcome.statistics = evaluator.statistics();
  return outcome;
}

double Sum(const PartTimes& times) {
  return std::accumulate(times.seconds.begin(), times.seconds.end(), 0.0);
}

TEST_CASE("rollout_parts: the clock changes no bits") {
  for (const QueryBackend backend : {QueryBackend::kFused, QueryBackend::kBlas}) {
    const Fixture f(20, 30, backend);
    CHECK(Run(f, 2, true).returns == Run(f, 2, false).returns);
  }
}

TEST_CASE("rollout_parts: nothing is timed unless it is asked for") {
  const PartTimes times = Run(Fixture(20), 1, false).statistics.parts;
  CHECK(Sum(times) == 0);
  CHECK(times.readings[kPartQueries] == 0);
}

TEST_CASE("rollout_parts: the parts make up the time that threads spend on tiles") {
  for (const QueryBackend backend : {QueryBackend::kFused, QueryBackend::kBlas}) {
    const Fixture f(40, 120, backend);
    for (const int threads : {1, 2}) {
      const EvaluatorStatistics s = Run(f, threads, true).statistics;
      const double busy = threads * s.seconds - s.idle_seconds;
      CAPTURE(threads);
      CHECK(Sum(s.parts) <= busy);
      CHECK(Sum(s.parts) >= 0.9 * busy);
      for (int part = 0; part < kRolloutParts; ++part) CHECK(s.parts.readings[part] > 0);
      // 30 points and more: they are most of the work by far.
      CHECK(s.parts.seconds[kPartQueries] > 0.4 * busy);
    }
  }
}

TEST_CASE("rollout_parts: times of a batch are what it added") {
  PartTimes sum, one;
  one.seconds[kPartPolicy] = 2;
  one.readings[kPartPolicy] = 3;
  sum += one;
  sum += one;
  CHECK(sum.seconds[kPartPolicy] == 4);
  CHECK(sum.readings[kPartPolicy] == 6);
  sum -= one;
  CHECK(sum.seconds[kPartPolicy] == 2);
  CHECK(sum.readings[kPartPolicy] == 3);
  EvaluatorStatistics later, earlier;
  later.parts = sum;
  earlier.parts = one;
  CHECK(later.Since(earlier).parts.readings[kPartPolicy] == 0);
}

}  // namespace
}  // namespace downpour
