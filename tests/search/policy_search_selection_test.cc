// SPDX-License-Identifier: Apache-2.0
// Successive halving: which runs go on, with how many rollouts, and what becomes of the budget.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "engine/search/policy_search.h"
#include "tests/search/noisy_search.h"

namespace downpour {
namespace {

// Rastrigin's function, milder: runs end in different local optima.
double Rastrigin(std::span<const double> x) {
  double sum = 0;
  for (const double v : x) sum += v * v + 3 * (1 - std::cos(6 * v));
  return 40 - sum;
}

TEST_CASE("policy_search: the best runs get the rest of the budget") {
  // So small a budget that most runs do not converge.
  PolicySearchOptions options = SmallOptions();
  options.evaluations = 20000;
  options.concurrent = 8;
  options.exploration = 0.4;
  std::int64_t used = 0;
  const PolicySearchResult result = Search(options, Noisy(Rastrigin, 1, &used));
  CHECK(used <= options.evaluations);
  CHECK(result.evaluations == used);
  // Runs share the exploration alike: only a promoted one can have had half as much again.
  const auto longest =
      std::max_element(result.runs.begin(), result.runs.end(),
                       [](const auto& a, const auto& b) { return a.evaluations < b.evaluations; });
  CHECK(longest->evaluations > 1.5 * 0.4 * 20000 / 8);
  const auto [worst, best] = std::minmax_element(
      result.runs.begin(), result.runs.end(),
      [](const auto& a, const auto& b) { return a.mean_return < b.mean_return; });
  CHECK(worst->mean_return < best->mean_return - 0.5);
  // Which is not the best if that has converged.
  const auto behind =
      std::count_if(result.runs.begin(), result.runs.end(),
                    [&](const RunRecord& run) { return run.mean_return < longest->mean_return; });
  CHECK(2 * behind >= std::ssize(result.runs));
}

TEST_CASE("policy_search: runs that were passed over go on before new ones start") {
  PolicySearchOptions options = SmallOptions();
  options.evaluations = 120000;
  options.concurrent = 8;
  options.exploration = 0.4;
  options.promotions = 2;
  const PolicySearchResult result = Search(options, Noisy(Rastrigin, 1));
  REQUIRE(result.runs.size() > 8);
  // Only the two of the last stage are left: all others have converged.
  CHECK(std::count_if(result.runs.begin(), result.runs.end(),
                      [](const RunRecord& run) { return run.stop == "budget"; }) == 2);
}

// Of the candidates of run `run`, 10 x kP: mean and variance of one coordinate.
std::pair<double, double> Moments(const CandidateBatch& batch, std::size_t run,
                                  std::size_t coordinate) {
  double sum = 0, squares = 0;
  for (std::size_t c = 10 * run; c < 10 * run + 10; ++c) {
    const double x = batch.parameters[c * kP + coordinate];
    sum += x;
    squares += x * x;
  }
  return {sum / 10, (squares - sum * sum / 10) / 9};
}

TEST_CASE("policy_search: promotions halve the runs, down to two, which fill as many lanes") {
  PolicySearchOptions options = SmallOptions();
  options.evaluations = 40000;
  options.concurrent = 8;
  options.population = 10;
  options.exploration = 0.4;
  options.promotions = 3;
  struct Stage {
    int n_runs = 0;
    std::int64_t spent = 0;
    bool full = false;  // some run had the rollouts that fill all lanes
  };
  std::vector<Stage> stages;
  bool compared = true;
  double largest_distance = 0;  // of the last two means, in standard deviations of its estimate
  bool equal = false;
  const BatchObjective inner = Noisy(Rastrigin, 1);
  const auto objective = [&](const CandidateBatch& batch, std::span<double> returns) {
    inner(batch, returns);
    // More than 8 rollouts: a comparison, after which a stage begins.
    const bool compares = batch.n_rollouts[0] > 8;
    if (!compares && compared) {
      stages.push_back({batch.n_candidates / 10});
      for (std::size_t i = 0; i < kP && stages.size() == 4 && batch.n_candidates == 20; ++i) {
        const auto [mean_0, variance_0] = Moments(batch, 0, i);
        const auto [mean_1, variance_1] = Moments(batch, 1, i);
        const double distance =
            std::abs(mean_0 - mean_1) / std::sqrt((variance_0 + variance_1) / 10);
        largest_distance = std::max(largest_distance, distance);
        equal = equal || mean_0 == mean_1;
      }
    }
    compared = compares;
    if (compares) return;
    Stage& stage = stages.back();
    // A run that begins in the place of one that has converged has one rollout a candidate.
    const int most = *std::max_element(batch.n_rollouts.begin(), batch.n_rollouts.end());
    CHECK((most == 1 || most * stage.n_runs == 8));
    stage.full = stage.full || most * stage.n_runs == 8;
    stage.spent += std::ssize(returns);
  };
  const PolicySearchResult result = Search(options, objective);
  REQUIRE(stages.size() == 4);
  // A batch less or more; the final comparison takes at most a fifth of the budget and 48 rollouts
  // a run, as do the three between the stages.
  for (std::size_t k = 0; k < 4; ++k) {
    CHECK(stages[k].n_runs == std::max(2, 8 >> k));
    CHECK(stages[k].full);
    const double share = k == 0 ? 0.4 : 0.2;
    const auto spent = static_cast<double>(stages[k].spent);
    CHECK(spent < share * 40000 + 80);
    CHECK(spent > share * (0.8 * 40000 - 4.0 * 48 * static_cast<double>(result.runs.size())) - 80);
  }
  // The last two are the best run, with random numbers of its own each: candidates of one
  // distribution. Student's t of 18 degrees of freedom is above 7 once in 10^6.
  CHECK(largest_distance < 7);
  CHECK(!equal);
}

TEST_CASE("policy_search: the local share of the restarts begins at the last policy") {
  // The first run, and of the seven restarts as many as the share has room for.
  for (const double share : {0.0, 0.5, 0.75, 1.0}) {
    const int expected = 1 + static_cast<int>(7 * share);
    PolicySearchOptions options = SmallOptions();
    options.concurrent = 8;
    options.population = 10;
    options.first_sigma = 1e-3;
    options.local_share = share;
    const std::vector<double> start(kP, 1.25);
    int near = 0, batches = 0;
    const BatchObjective inner = Noisy(Hill, 1);
    const auto objective = [&](const CandidateBatch& batch, std::span<double> returns) {
      inner(batch, returns);
      if (batches++ > 0) return;
      for (std::size_t run = 0; run < 8; ++run) {
        const auto first = batch.parameters.subspan(run * 10 * kP, kP);
        near += std::all_of(first.begin(), first.end(),
                            [](double v) { return std::abs(v - 1.25) < 0.01; });
      }
    };
    const PolicySearchResult result = SearchPolicy(options, start, 1, 1, objective, {}, nullptr);
    CHECK(near == expected);
    CHECK(std::count_if(result.runs.begin(), result.runs.begin() + 8, [](const RunRecord& run) {
            return run.initial_sigma == 1e-3;
          }) == expected);
  }
}

TEST_CASE("policy_search: a selection between runs spends any budget and no more") {
  const auto check = [](const PolicySearchOptions& options, double noise) {
    std::int64_t used = 0;
    PolicySearchResult result;
    try {
      result = Search(options, Noisy(Hill, noise, &used));
    } catch (const InvalidInput& error) {  // less than one generation
      CHECK(std::string(error.what()).find("search.evaluations") != std::string::npos);
      CHECK(static_cast<double>(options.evaluations) * options.exploration < 1000);
      return;
    }
    CHECK(used <= options.evaluations);
    CHECK(used > 0.9 * static_cast<double>(options.evaluations));
    CHECK(result.evaluations == used);
    // Of all runs, each rollout once: the comparisons take the rest.
    std::int64_t searched = 0;
    for (const RunRecord& run : result.runs) searched += run.evaluations;
    CHECK(searched < used);
    CHECK(searched > 0.2 * static_cast<double>(used));
  };
  for (const std::int64_t evaluations : {600, 1000, 3000, 20000}) {
    for (const double exploration : {0.1, 0.55, 0.99}) {
      for (const double noise : {0.0, 1.0}) {
        PolicySearchOptions options = SmallOptions();
        options.evaluations = evaluations;
        options.exploration = exploration;
        check(options, noise);
      }
    }
  }
  for (const int promotions : {1, 10}) {
    for (const int concurrent : {2, 3, 8}) {
      for (const std::int64_t evaluations : {2400, 20000}) {
        PolicySearchOptions options = SmallOptions();
        options.evaluations = evaluations;
        options.promotions = promotions;
        options.concurrent = concurrent;
        options.population = 12;
        check(options, 1);
      }
    }
  }
}

TEST_CASE("policy_search: where runs converge early, others take the rest of the budget") {
  for (const RestartStrategy restarts :
       {RestartStrategy::kBipop, RestartStrategy::kSmall, RestartStrategy::kIpop}) {
    for (const int concurrent : {1, 4, 8}) {
      PolicySearchOptions options = SmallOptions();
      options.restarts = restarts;
      options.evaluations = 100000;
      options.concurrent = concurrent;
      std::int64_t used = 0;
      const PolicySearchResult result = Search(options, Noisy(Hill, 0, &used));
      CHECK(used <= options.evaluations);
      CHECK(used > 0.9 * static_cast<double>(options.evaluations));
      CHECK(Hill(result.parameters) > 39.99);
    }
  }
}

TEST_CASE("policy_search: a single run is followed by no other") {
  for (const double exploration : {0.5, 1.0}) {
    PolicySearchOptions options = SmallOptions();
    options.restarts = RestartStrategy::kSingle;
    options.exploration = exploration;
    options.evaluations = 100000;
    std::int64_t used = 0;
    const PolicySearchResult result = Search(options, Noisy(Hill, 0, &used));
    REQUIRE(result.runs.size() == 1);
    CHECK(result.runs[0].run == 0);
    CHECK(result.evaluations == used);
    CHECK(used < options.evaluations / 2);  // it has converged long before
    CHECK(Hill(result.parameters) > 39.99);
  }
}

TEST_CASE("policy_search: promotion keeps the rollouts that a run has adapted") {
  for (const int rollouts : {1, 15}) {
    PolicySearchOptions options = SmallOptions();
    options.evaluations = 40000;
    options.uncertainty = UncertaintyHandling::kRollouts;
    options.rollouts = rollouts;
    options.concurrent = 1;
    std::vector<int> n_rollouts;
    const BatchObjective inner = Noisy([](auto) { return 0.0; }, 1);
    Search(options, [&](const CandidateBatch& batch, std::span<double> returns) {
      inner(batch, returns);
      if (batch.n_candidates >= 18) n_rollouts.push_back(batch.n_rollouts[0]);
    });
    REQUIRE(n_rollouts.size() > 10);
    CHECK(*std::max_element(n_rollouts.begin(), n_rollouts.end()) == options.max_rollouts);
    for (std::size_t g = 1; g < n_rollouts.size(); ++g) {
      CHECK(n_rollouts[g] >= std::floor(n_rollouts[g - 1] / 1.5));
    }
    // The last stage: at least twice `rollouts`, within the limit.
    CHECK(n_rollouts.back() >= std::min(2 * rollouts, options.max_rollouts));
  }
}

TEST_CASE("policy_search: the last stage doubles the rollouts where they are not adapted") {
  PolicySearchOptions options = SmallOptions();
  options.rollouts = 3;
  options.concurrent = 1;
  std::vector<int> n_rollouts;
  const BatchObjective inner = Noisy([](auto) { return 0.0; }, 1);
  Search(options, [&](const CandidateBatch& batch, std::span<double> returns) {
    inner(batch, returns);
    if (batch.n_candidates >= 18) n_rollouts.push_back(batch.n_rollouts[0]);
  });
  CHECK(std::is_sorted(n_rollouts.begin(), n_rollouts.end()));
  CHECK(n_rollouts.front() == 3);
  CHECK(n_rollouts.back() == 6);
}

TEST_CASE("policy_search: runs that all go on are not compared") {
  PolicySearchOptions options = SmallOptions();
  options.concurrent = 1;
  int of_one = 0;
  const BatchObjective inner = Noisy(Hill, 1);
  Search(options, [&](const CandidateBatch& batch, std::span<double> returns) {
    inner(batch, returns);
    of_one += batch.n_candidates == 1;
  });
  CHECK(of_one == 1);  // the estimate of the winner
}

TEST_CASE("policy_search: under BIPOP every run side by side may have 100 generations") {
  PolicySearchOptions options = SmallOptions();
  options.restarts = RestartStrategy::kBipop;
  options.evaluations = 60000;
  options.concurrent = 8;
  const PolicySearchResult result = Search(options, Noisy(Hill, 0));
  int largest = 0;
  for (const RunRecord& run : result.runs) largest = std::max(largest, run.population);
  CHECK(largest == 60000 / (8 * 100));
}

TEST_CASE("policy_search: the predicted return of the winner is unbiased") {
  // Every policy has mean return 0, but each its own noise, so that the winner of the comparison
  // is the luckiest.
  const BatchObjective noise = [](const CandidateBatch& batch, std::span<double> returns) {
    std::size_t k = 0;
    for (std::size_t c = 0; c < static_cast<std::size_t>(batch.n_candidates); ++c) {
      const auto x = batch.parameters.subspan(c * kP, kP);
      for (int r = 0; r < batch.n_rollouts[c]; ++r) {
        double z[kP], product = 0, square = 1e-300;
        FillNormals(batch.keys[c], static_cast<std::uint32_t>(batch.first_rollout[c] + r), z, kP);
        for (std::size_t i = 0; i < kP; ++i) product += z[i] * x[i], square += x[i] * x[i];
        returns[k++] = product / std::sqrt(square);
      }
    }
  };
  PolicySearchOptions options = SmallOptions();
  options.evaluations = 4500;  // 100 rollouts of the winner
  options.population = 4;
  constexpr int kSearches = 40;
  double sum = 0, largest = 0;
  for (int seed = 0; seed < kSearches; ++seed) {
    const PolicySearchResult result =
        SearchPolicy(options, std::vector<double>(kP, 0.0), seed, 1, noise, {}, nullptr);
    sum += result.predicted_return;
    double best = 0;
    for (const RunRecord& run : result.runs) best = std::max(best, run.mean_return);
    largest += best;
  }
  const double standard_error = 1 / std::sqrt(100.0 * kSearches);
  CHECK(std::abs(sum / kSearches) < 4 * standard_error);
  CHECK(largest / kSearches > 4 * standard_error);  // what the comparison would have said
}

TEST_CASE("policy_search: exploration's generations are relaxed, no comparison and no stage is") {
  PolicySearchOptions options = SmallOptions();
  options.exploration = 0.4;
  const BatchObjective inner = Noisy(Hill, 1);
  const auto count_relaxed = [&] {
    std::int64_t relaxed = 0;
    bool compared = false;
    Search(options, [&](const CandidateBatch& batch, std::span<double> returns) {
      inner(batch, returns);
      // Comparisons have many rollouts a candidate; a stage begins after the first of them.
      compared = compared || batch.n_rollouts[0] > 8;
      CHECK((!batch.relaxed || !compared));
      if (batch.relaxed) relaxed += std::ssize(returns);
    });
    CHECK(compared);
    return static_cast<double>(relaxed);
  };
  CHECK(count_relaxed() == doctest::Approx(0.4 * 12000).epsilon(0.2));
  options.exploration = 1;  // nothing comes after it
  CHECK(count_relaxed() == 0);
  options.exploration = 0.4;
  options.restarts = RestartStrategy::kSingle;  // what has converged would not go on
  CHECK(count_relaxed() == 0);
  options.restarts = RestartStrategy::kSmall;
  options.relaxed_exploration = false;
  CHECK(count_relaxed() == 0);
}

TEST_CASE("policy_search: candidates of a generation compete, those of a comparison do not") {
  PolicySearchOptions options = SmallOptions();
  options.population = 11;
  const BatchObjective inner = Noisy(Hill, 1);
  const PolicySearchResult without = Search(options, [&](const auto& batch, auto returns) {
    CHECK(batch.groups.empty());
    inner(batch, returns);
  });
  options.stop_lost_causes = true;
  int generations = 0, comparisons = 0;
  const PolicySearchResult with = Search(options, [&](const auto& batch, auto returns) {
    inner(batch, returns);
    if (batch.n_rollouts[0] > 4) {
      CHECK(batch.groups.empty());
      ++comparisons;
      return;
    }
    ++generations;
    CHECK(static_cast<int>(batch.groups.size()) == batch.n_candidates / 11);
    for (const CandidateGroup& group : batch.groups) {
      CHECK(group.n_candidates == 11);
      CHECK(group.n_exact == 6);  // five parents and the median
    }
  });
  CHECK(generations > 100);
  CHECK(comparisons >= 4);
  // This objective stops nothing.
  CHECK(with.parameters == without.parameters);
  CHECK(with.evaluations == without.evaluations);
}

}  // namespace
}  // namespace downpour
