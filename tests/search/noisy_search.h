// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include "engine/search/policy_search.h"

// Searches of kP parameters on functions with additive noise.
namespace downpour {

inline constexpr std::size_t kP = 6;

using MeanReturn = std::function<double(std::span<const double>)>;

// A hill of height 40 and width 3 around (1.5, -1.5, 1.5, ...).
inline double Hill(std::span<const double> x) {
  double sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) sum += std::pow(x[i] - (i % 2 ? -1.5 : 1.5), 2);
  return 40 * std::exp(-sum / (2 * 9));
}

// Evaluates mean(x) + noise z in the order given by `reverse`, and counts rollouts.
inline BatchObjective Noisy(MeanReturn mean, double noise, std::int64_t* rollouts = nullptr,
                            bool reverse = false) {
  return [=](const CandidateBatch& batch, std::span<double> returns) {
    const auto n = static_cast<std::size_t>(batch.n_candidates);
    const std::size_t p = batch.parameters.size() / n;
    std::vector<std::pair<std::size_t, int>> work;
    for (std::size_t c = 0; c < n; ++c) {
      for (int r = 0; r < batch.n_rollouts[c]; ++r) work.emplace_back(c, r);
    }
    REQUIRE(work.size() == returns.size());
    std::vector<std::size_t> order(work.size());
    std::iota(order.begin(), order.end(), 0);
    if (reverse) std::reverse(order.begin(), order.end());
    for (const std::size_t k : order) {
      const auto [c, r] = work[k];
      double z;
      FillNormals(batch.keys[c], static_cast<std::uint32_t>(batch.first_rollout[c] + r), &z, 1);
      returns[k] = mean(batch.parameters.subspan(c * p, p)) + noise * z;
    }
    if (rollouts != nullptr) *rollouts += static_cast<std::int64_t>(returns.size());
  };
}

inline PolicySearchOptions SmallOptions() {
  PolicySearchOptions options;
  options.evaluations = 12000;
  options.concurrent = 4;
  options.population = 18;
  options.common_random_numbers = CommonRandomNumbers::kOff;
  return options;
}

inline PolicySearchResult Search(const PolicySearchOptions& options,
                                 const BatchObjective& objective) {
  return SearchPolicy(options, std::vector<double>(kP, 0.0), 1, 2, objective, {}, nullptr);
}

}  // namespace downpour
