// SPDX-License-Identifier: Apache-2.0
#include "engine/search/uncertainty.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

namespace downpour {
namespace {

constexpr double kTheta = 0.2;           // tolerated rank changes
constexpr double kRolloutsFactor = 1.5;  // alpha_t

}  // namespace

int ReevaluationCount(int population, double uniform) {
  const double expected = std::max(0.1, 2.0 / population) * population;
  const double whole = std::floor(expected);
  const int count = static_cast<int>(whole) + (uniform < expected - whole ? 1 : 0);
  return std::clamp(count, 1, population);
}

double RankChangeLimit(int rank, int population) {
  const int n = 2 * population - 1;
  // Sorted, the distances |j - R| are 0, 1, 1, ..., a, a, a + 1, ..., where a is the distance to
  // the nearer end.
  const int paired = std::min(rank - 1, n - rank);
  const auto distance = [&](int k) { return k <= 2 * paired ? (k + 1) / 2 : k - paired; };
  const double position = std::clamp(kTheta * 50 / 100 * n - 0.5, 0.0, n - 1.0);
  const int k = std::min(static_cast<int>(position), n - 2);
  return distance(k) + (position - k) * (distance(k + 1) - distance(k));
}

double SigmaFactor(int dimension) { return 1 + 2.0 / (dimension + 10); }

double AdaptedRollouts(double rollouts, double measure, double min, double max) {
  if (measure > 0) return std::min(kRolloutsFactor * rollouts, max);
  if (measure < 0) return std::max(rollouts / kRolloutsFactor, min);
  return rollouts;
}

UncertaintyMeasure::UncertaintyMeasure(int population)
    : population_(population),
      order_(2 * population),
      rank_(2 * population),
      change_(population),
      mean_cost_(population) {}

void UncertaintyMeasure::RankJointly(std::span<const double> costs,
                                     std::span<const double> reevaluated) {
  const auto cost = [&](int k) {
    const int c = k % population_;
    return k >= population_ && c < static_cast<int>(reevaluated.size()) ? reevaluated[c] : costs[c];
  };
  std::iota(order_.begin(), order_.end(), 0);
  std::sort(order_.begin(), order_.end(), [&](int a, int b) {
    return std::tuple(cost(a), a % population_, a) < std::tuple(cost(b), b % population_, b);
  });
  for (int k = 0; k < 2 * population_; ++k) rank_[order_[k]] = k + 1;
}

double UncertaintyMeasure::Measure(std::span<const double> costs,
                                   std::span<const double> reevaluated, std::span<int> ranking) {
  RankJointly(costs, reevaluated);
  const int n_reevaluated = static_cast<int>(reevaluated.size());
  double sum = 0, change_sum = 0;
  for (int c = 0; c < n_reevaluated; ++c) {
    const int old_rank = rank_[c], new_rank = rank_[population_ + c];
    change_[c] = std::abs(new_rank - old_rank) - 1;  // |Delta_i|
    sum += 2 * change_[c] - RankChangeLimit(new_rank - (new_rank > old_rank), population_) -
           RankChangeLimit(old_rank - (old_rank > new_rank), population_);
    change_sum += change_[c];
    mean_cost_[c] = (costs[c] + reevaluated[c]) / 2;
  }
  for (int c = n_reevaluated; c < population_; ++c) {
    change_[c] = change_sum / n_reevaluated;
    mean_cost_[c] = costs[c];
  }
  const auto key = [&](int c) {
    return std::tuple(rank_[c] + rank_[population_ + c], change_[c], mean_cost_[c], c);
  };
  std::iota(ranking.begin(), ranking.end(), 0);
  std::sort(ranking.begin(), ranking.end(), [&](int a, int b) { return key(a) < key(b); });
  return sum / n_reevaluated;
}

}  // namespace downpour
