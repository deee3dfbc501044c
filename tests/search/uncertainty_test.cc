// SPDX-License-Identifier: Apache-2.0
#include "engine/search/uncertainty.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// Percentile by sorting, x_k being the (k - 1/2) / N quantile.
double Percentile(std::vector<double> values, double percent) {
  std::sort(values.begin(), values.end());
  const double n = static_cast<double>(values.size());
  for (std::size_t k = 0; k + 1 < values.size(); ++k) {
    const double low = (static_cast<double>(k) + 0.5) / n, high = low + 1 / n;
    if (percent / 100 < low) return values[k];
    if (percent / 100 <= high) {
      return values[k] + (percent / 100 - low) / (high - low) * (values[k + 1] - values[k]);
    }
  }
  return values.back();
}

double Limit(int rank, int population) {
  std::vector<double> distances;
  for (int j = 1; j <= 2 * population - 1; ++j) distances.push_back(std::abs(j - rank));
  return Percentile(distances, 0.2 * 50);
}

struct Evaluation {
  double cost;
  int candidate;
  bool second;
};

// 1 + the number of evaluations ahead; equal costs by candidate, the first evaluation first.
int Rank(const std::vector<Evaluation>& all, const Evaluation& e) {
  int rank = 1;
  for (const Evaluation& other : all) {
    if (other.cost != e.cost) {
      rank += other.cost < e.cost;
    } else if (other.candidate != e.candidate) {
      rank += other.candidate < e.candidate;
    } else {
      rank += !other.second && e.second;
    }
  }
  return rank;
}

double Sign(double x) { return (x > 0) - (x < 0); }

// s straight from the formulas, and the rank sums.
double MeasureByFormulas(const std::vector<double>& costs, const std::vector<double>& again,
                         std::vector<int>& rank_sums) {
  const int lambda = static_cast<int>(costs.size());
  std::vector<Evaluation> all;
  for (int c = 0; c < lambda; ++c) {
    all.push_back({costs[c], c, false});
    all.push_back({c < static_cast<int>(again.size()) ? again[c] : costs[c], c, true});
  }
  double s = 0;
  for (int c = 0; c < lambda; ++c) {
    const int old_rank = Rank(all, all[2 * c]), new_rank = Rank(all, all[2 * c + 1]);
    rank_sums.push_back(old_rank + new_rank);
    if (c >= static_cast<int>(again.size())) continue;
    const double delta = new_rank - old_rank - Sign(new_rank - old_rank);
    s += 2 * std::abs(delta) - Limit(new_rank - (new_rank > old_rank ? 1 : 0), lambda) -
         Limit(old_rank - (old_rank > new_rank ? 1 : 0), lambda);
  }
  return s / static_cast<double>(again.size());
}

TEST_CASE("uncertainty: the measure and the ranking are those of the formulas") {
  for (const int lambda : {2, 3, 5, 8, 16, 33}) {
    for (std::uint32_t trial = 0; trial < 30; ++trial) {
      const StreamKey key = DeriveKey(1, StreamPurpose::kEvaluate, {trial});
      std::vector<double> costs(lambda), noise(lambda);
      FillNormals(key, 0, costs.data(), costs.size());
      FillNormals(key, 1, noise.data(), noise.size());
      const int n = 1 + static_cast<int>(trial) % lambda;
      std::vector<double> again(n);
      for (int c = 0; c < n; ++c) again[c] = costs[c] + 0.1 * trial * noise[c];
      if (trial % 3 == 0) {  // ties
        for (double& value : costs) value = std::round(value);
        for (double& value : again) value = std::round(value);
      }
      UncertaintyMeasure measure(lambda);
      std::vector<int> ranking(lambda), rank_sums;
      const double s = measure.Measure(costs, again, ranking);
      CHECK(s == doctest::Approx(MeasureByFormulas(costs, again, rank_sums)).epsilon(1e-12));
      CHECK(std::is_permutation(ranking.begin(), ranking.end(),
                                [&] {
                                  std::vector<int> all(lambda);
                                  for (int c = 0; c < lambda; ++c) all[c] = c;
                                  return all;
                                }()
                                    .begin()));
      for (int k = 0; k + 1 < lambda; ++k) {
        CHECK(rank_sums[ranking[k]] <= rank_sums[ranking[k + 1]]);
      }
    }
  }
}

TEST_CASE("uncertainty: the limit is the percentile of all rank changes") {
  for (const int lambda : {2, 3, 7, 24, 100}) {
    for (int rank = 1; rank <= 2 * lambda - 1; ++rank) {
      CHECK(RankChangeLimit(rank, lambda) == doctest::Approx(Limit(rank, lambda)).epsilon(1e-12));
    }
  }
}

TEST_CASE("uncertainty: exact values measure negative, pure noise positive") {
  constexpr int kLambda = 24;
  std::vector<int> ranking(kLambda);
  UncertaintyMeasure measure(kLambda);
  double noisy = 0;
  for (std::uint32_t trial = 0; trial < 50; ++trial) {
    std::vector<double> values(2 * kLambda);
    FillNormals(DeriveKey(2, StreamPurpose::kEvaluate, {trial}), 0, values.data(), values.size());
    const std::span<const double> costs(values.data(), kLambda);
    CHECK(measure.Measure(costs, costs.first(3), ranking) < 0);
    CHECK(std::is_sorted(ranking.begin(), ranking.end(),
                         [&](int a, int b) { return costs[a] < costs[b]; }));
    noisy += measure.Measure(costs, {values.data() + kLambda, 3}, ranking);
  }
  CHECK(noisy / 50 > 5);
  // A flat function is certain.
  const std::vector<double> flat(kLambda, 0.0);
  CHECK(measure.Measure(flat, std::span(flat).first(3), ranking) < 0);
}

TEST_CASE("uncertainty: re-evaluates r lambda candidates on average") {
  for (const int lambda : {2, 8, 20, 24, 37}) {
    double sum = 0;
    for (int i = 0; i < 1000; ++i) {
      const int n = ReevaluationCount(lambda, i / 1000.0);
      CHECK(n >= 1);
      CHECK(n <= lambda);
      sum += n;
    }
    CHECK(sum / 1000 == doctest::Approx(std::max(2.0, 0.1 * lambda)).epsilon(1e-3));
  }
}

TEST_CASE("uncertainty: treatments are those of the paper") {
  CHECK(SigmaFactor(71) == doctest::Approx(1 + 2.0 / 81));
  CHECK(AdaptedRollouts(4, 1, 1, 20) == 6);
  CHECK(AdaptedRollouts(15, 1, 1, 20) == 20);
  CHECK(AdaptedRollouts(6, -1, 1, 20) == 4);
  CHECK(AdaptedRollouts(1.2, -1, 1, 20) == 1);
  CHECK(AdaptedRollouts(6, 0, 1, 20) == 6);
}

}  // namespace
}  // namespace downpour
