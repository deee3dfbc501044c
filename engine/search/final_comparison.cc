// SPDX-License-Identifier: Apache-2.0
#include "engine/search/final_comparison.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>

#include "engine/errors.h"

namespace downpour {
namespace {

// With returns of standard deviation s the screening means err by s / 7: enough to keep a best
// candidate among the finalists, and a tenth of the default full comparison.
constexpr int kScreeningRollouts = 48;

int ScreeningRollouts(int n_candidates, int final_rollouts) {
  return n_candidates > kFinalists ? std::min(kScreeningRollouts, final_rollouts) : 0;
}

// Adds rollouts [first, first + n) of the candidates `which` to their sums.
void AddRollouts(std::span<const double> candidates, std::size_t dimension,
                 std::span<const int> which, int first, int n, StreamKey key,
                 const BatchObjective& objective, const std::atomic<bool>* stop,
                 FinalComparison& result) {
  if (stop != nullptr && stop->load()) throw Interrupted();
  std::vector<double> parameters, returns(which.size() * static_cast<std::size_t>(n));
  for (const int c : which) {
    const auto row = candidates.subspan(static_cast<std::size_t>(c) * dimension, dimension);
    parameters.insert(parameters.end(), row.begin(), row.end());
  }
  const std::vector<StreamKey> keys(which.size(), key);
  const std::vector<int> n_rollouts(which.size(), n), first_rollout(which.size(), first);
  objective({static_cast<int>(which.size()), parameters, keys, n_rollouts, first_rollout}, returns);
  for (std::size_t k = 0; k < returns.size(); ++k) {
    const double value = returns[k];
    result.mean_returns[static_cast<std::size_t>(which[k / static_cast<std::size_t>(n)])] +=
        std::isfinite(value) ? value : -std::numeric_limits<double>::infinity();
  }
  result.evaluations += static_cast<std::int64_t>(returns.size());
}

}  // namespace

std::int64_t FinalComparisonCost(int n_candidates, int final_rollouts) {
  const std::int64_t screening = ScreeningRollouts(n_candidates, final_rollouts);
  const std::int64_t finalists = std::min(n_candidates, kFinalists);
  return screening * n_candidates + (final_rollouts - screening) * finalists;
}

FinalComparison CompareFinalMeans(std::span<const double> candidates, int n_candidates,
                                  int final_rollouts, StreamKey key,
                                  const BatchObjective& objective, const std::atomic<bool>* stop) {
  const std::size_t dimension = candidates.size() / static_cast<std::size_t>(n_candidates);
  FinalComparison result;
  result.mean_returns.assign(static_cast<std::size_t>(n_candidates), 0);
  std::vector<double>& sums = result.mean_returns;
  std::vector<int> which(static_cast<std::size_t>(n_candidates));
  std::iota(which.begin(), which.end(), 0);

  const int screening = ScreeningRollouts(n_candidates, final_rollouts);
  if (screening > 0) {
    AddRollouts(candidates, dimension, which, 0, screening, key, objective, stop, result);
    // Candidate 0 stays in front.
    std::stable_sort(which.begin() + 1, which.end(), [&](int a, int b) {
      return sums[static_cast<std::size_t>(a)] > sums[static_cast<std::size_t>(b)];
    });
    for (std::size_t k = kFinalists; k < which.size(); ++k) {
      sums[static_cast<std::size_t>(which[k])] /= screening;
    }
    which.resize(kFinalists);
  }
  if (final_rollouts > screening) {
    AddRollouts(candidates, dimension, which, screening, final_rollouts - screening, key, objective,
                stop, result);
  }
  for (const int c : which) sums[static_cast<std::size_t>(c)] /= final_rollouts;
  result.best = *std::max_element(which.begin(), which.end(), [&](int a, int b) {
    return sums[static_cast<std::size_t>(a)] < sums[static_cast<std::size_t>(b)];
  });
  return result;
}

}  // namespace downpour
