// SPDX-License-Identifier: Apache-2.0
// What a run of a policy search reports as found: means averaged over generations.
#include "engine/search/search_run.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "tests/search/noisy_search.h"

namespace downpour {
namespace {

// A box so wide that its transform changes nothing where these runs go.
PolicySearchOptions WideOptions() {
  PolicySearchOptions options;
  options.bound = 1000;
  return options;
}

SearchRun NewRun(const PolicySearchOptions& options, std::uint64_t seed) {
  RunPlan plan;
  plan.population = options.population;
  plan.sigma = 1;
  return SearchRun(options, plan, std::vector<double>(kP, 0.0), seed, 1);
}

// The next generation of one run.
void Advance(const BatchObjective& objective, SearchRun* run) {
  SearchBatch batch;
  LayOut({&run, 1}, false, &batch);
  run->Ask(&batch);
  objective(batch.Candidates(), batch.returns);
  run->Tell(batch);
}

double SquaredDistance(std::span<const double> x) {
  double sum = 0;
  for (const double value : x) sum += value * value;
  return sum;
}

TEST_CASE("search_run: the averaged mean is the weighted sum of the generations' means") {
  SearchRun run = NewRun(WideOptions(), 1);
  CHECK(run.AveragedMean() == run.Mean());
  const BatchObjective objective = Noisy(Hill, 1);
  std::vector<std::vector<double>> means;
  for (int t = 1; t <= 60; ++t) {
    Advance(objective, &run);
    means.push_back(run.Mean());
    const std::vector<double> averaged = run.AveragedMean();
    // 1/12 (11/12)^(t - k) for generation k > 12; the first twelve share the rest alike.
    constexpr long double kDecay = 11.0L / 12;
    for (std::size_t i = 0; i < kP; ++i) {
      long double expected = 0, largest = 0;
      for (int k = 1; k <= t; ++k) {
        long double weight = 0;
        if (t <= 12) {
          weight = 1.0L / t;
        } else {
          weight = std::pow(kDecay, t - std::max(k, 12)) / 12;
        }
        const long double mean = means[static_cast<std::size_t>(k - 1)][i];
        expected += weight * mean;
        largest = std::max(largest, std::abs(mean));
      }
      // Three roundings a generation, of numbers no larger than twice the largest mean; weights
      // keep what they add below 12 generations' worth.
      const double tolerance =
          12 * 3 * std::numeric_limits<double>::epsilon() * static_cast<double>(largest);
      CHECK(std::abs(averaged[i] - static_cast<double>(expected)) <= tolerance);
    }
  }
}

TEST_CASE("search_run: under noise the averaged mean is nearer to the optimum") {
  // A sphere about a point that is drawn anew, N(0, 1) a coordinate, for every generation: all of
  // its candidates meet the same one, and the mean runs after it. The expected return is best at 0.
  const BatchObjective objective = [](const CandidateBatch& batch, std::span<double> returns) {
    double centre[kP];
    for (std::size_t c = 0; c < returns.size(); ++c) {
      FillNormals(batch.keys[c], 0, centre, kP);
      returns[c] = 0;
      for (std::size_t i = 0; i < kP; ++i) {
        returns[c] -= std::pow(batch.parameters[c * kP + i] - centre[i], 2);
      }
    }
  };
  const PolicySearchOptions options = WideOptions();
  double of_means = 0, of_averages = 0;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    SearchRun run = NewRun(options, seed);
    for (int t = 0; t < 200; ++t) Advance(objective, &run);
    of_means += SquaredDistance(run.Mean());
    of_averages += SquaredDistance(run.AveragedMean());
  }
  MESSAGE("squared distance, sum of 30 runs: ", of_means, ", averaged ", of_averages);
  CHECK(of_averages < 0.5 * of_means);
}

TEST_CASE("search_run: a search returns the averaged mean") {
  PolicySearchOptions options = SmallOptions();
  options.restarts = RestartStrategy::kSingle;
  options.exploration = 1;
  options.evaluations = 1500;
  std::vector<double> mean, averaged;
  const PolicySearchResult result = SearchPolicy(
      options, std::vector<double>(kP, 0.0), 1, 1, Noisy(Hill, 1),
      [&](const PolicySearchProgress& now) {
        if (now.runs.empty()) return;
        REQUIRE(now.runs.size() == 1);
        mean = now.runs[0].Mean();
        averaged = now.runs[0].AveragedMean();
      },
      nullptr);
  CHECK(mean != averaged);
  CHECK(result.parameters == averaged);
}

}  // namespace
}  // namespace downpour
