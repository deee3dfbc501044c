// SPDX-License-Identifier: Apache-2.0
#include "engine/search/final_comparison.h"

#include <doctest/doctest.h>

#include <functional>
#include <limits>
#include <numeric>
#include <vector>

namespace downpour {
namespace {

// The return of candidate x (one parameter) in its rollout r.
BatchObjective Objective(const std::function<double(double, int)>& value) {
  return [value](const CandidateBatch& batch, std::span<double> returns) {
    std::size_t k = 0;
    for (int c = 0; c < batch.n_candidates; ++c) {
      CHECK(batch.keys[c] == StreamKey{1, 2});
      for (int r = 0; r < batch.n_rollouts[c]; ++r) {
        returns[k++] = value(batch.parameters[c], batch.first_rollout[c] + r);
      }
    }
    CHECK(k == returns.size());
  };
}

FinalComparison Compare(int n, int final_rollouts,
                        const std::function<double(double, int)>& value) {
  std::vector<double> candidates(n);
  std::iota(candidates.begin(), candidates.end(), 0);
  return CompareFinalMeans(candidates, n, final_rollouts, {1, 2}, Objective(value), nullptr);
}

TEST_CASE("final_comparison: means and costs are those of the rollouts") {
  for (const int n : {1, 5, 8, 9, 30}) {
    for (const int rollouts : {1, 20, 48, 49, 300}) {
      const auto result = Compare(n, rollouts, [](double x, int r) { return x + r; });
      CHECK(result.best == n - 1);
      CHECK(result.evaluations == FinalComparisonCost(n, rollouts));
      CHECK(result.mean_returns[n - 1] == doctest::Approx(n - 1 + (rollouts - 1) / 2.0));
      CHECK(result.mean_returns[0] == doctest::Approx((rollouts - 1) / 2.0));
    }
  }
  CHECK(FinalComparisonCost(8, 480) == 8 * 480);
  CHECK(FinalComparisonCost(30, 480) == 30 * 48 + 8 * 432);
}

TEST_CASE("final_comparison: candidate 0 is a finalist even if the screening puts it last") {
  const auto result =
      Compare(30, 480, [](double x, int r) { return x == 0 ? (r < 48 ? -1.0 : 100.0) : x; });
  CHECK(result.best == 0);
  CHECK(result.mean_returns[0] == doctest::Approx((432 * 100.0 - 48) / 480));
  CHECK(result.mean_returns[1] == 1);  // by the screening alone
}

TEST_CASE("final_comparison: a return that is not finite loses, whatever its sign") {
  const double infinity = std::numeric_limits<double>::infinity();
  const auto result = Compare(12, 100, [&](double x, int r) {
    if (x == 11 && r == 60) return infinity;
    if (x == 10 && r == 3) return std::numeric_limits<double>::quiet_NaN();
    return x;
  });
  CHECK(result.best == 9);
  CHECK(result.mean_returns[10] == -infinity);
  CHECK(result.mean_returns[11] == -infinity);
}

}  // namespace
}  // namespace downpour
