// SPDX-License-Identifier: Apache-2.0
#include "engine/search/minimise.h"

#include <doctest/doctest.h>

#include <cmath>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "tests/search/test_functions.h"

namespace downpour {
namespace {

// All of a population at once.
PopulationObjective Population(const TestFunction& function, std::size_t dimension) {
  return [=](std::span<const double> candidates, std::span<double> costs) {
    for (std::size_t c = 0; c < costs.size(); ++c) {
      costs[c] = function(candidates.subspan(c * dimension, dimension));
    }
  };
}

TEST_CASE("minimise: a user's own function is minimised with restarts in a few lines") {
  MinimiseOptions options;
  options.lower = {-4, -4, -4};
  options.upper = {4, 4, 4};
  options.sigma = 2;
  options.target = 1e-8;
  const MinimiseResult result = Minimise(options, [](auto candidates, auto costs) {
    for (std::size_t c = 0; c < costs.size(); ++c)
      costs[c] = Rastrigin(candidates.subspan(3 * c, 3));
  });
  CHECK(result.best_cost < 1e-8);
  CHECK(Rastrigin(result.best) == result.best_cost);
}

TEST_CASE("minimise: every strategy ends with the target, the budget or its one run") {
  for (const RestartStrategy restarts : {RestartStrategy::kBipop, RestartStrategy::kIpop,
                                         RestartStrategy::kSmall, RestartStrategy::kSingle}) {
    MinimiseOptions options;
    options.lower.assign(5, -4);
    options.upper.assign(5, 4);
    options.sigma = 2;
    options.restarts = restarts;
    options.evaluations = 40000;
    std::int64_t called = 0;
    const auto objective = [&](std::span<const double> candidates, std::span<double> costs) {
      called += static_cast<std::int64_t>(costs.size());
      Population(Rastrigin, 5)(candidates, costs);
    };
    const MinimiseResult all = Minimise(options, objective);
    CHECK(all.evaluations == called);
    CHECK(called <= options.evaluations);
    std::int64_t sum = 0;
    for (const MinimiseRun& run : all.runs) sum += run.evaluations;
    CHECK(sum == called);
    if (restarts == RestartStrategy::kSingle) {
      CHECK(all.runs.size() == 1);
      CHECK(all.runs[0].stop == "TolHistFun");
    } else if (restarts == RestartStrategy::kSmall) {
      CHECK(all.runs.back().stop == "budget");
    } else {
      CHECK(all.runs.back().stop == "budget");
      options.target = 1e-8;
      const MinimiseResult result = Minimise(options, objective);
      CHECK(result.runs.back().stop == "target");
      CHECK(result.best_cost < 1e-8);
    }
  }
}

TEST_CASE("minimise: an optimum on the bounds is reached and none is crossed") {
  MinimiseOptions options;
  options.lower.assign(4, 1);
  options.upper.assign(4, 5);
  options.bounded = true;
  options.restarts = RestartStrategy::kSingle;
  const MinimiseResult result = Minimise(options, Population(
                                                      [](std::span<const double> x) {
                                                        for (const double v : x) {
                                                          CHECK(v >= 1);
                                                          CHECK(v <= 5);
                                                        }
                                                        return Sphere(x);
                                                      },
                                                      4));
  CHECK(result.best_cost == doctest::Approx(4).epsilon(1e-8));
}

TEST_CASE("minimise: NaN and infinite costs are worse than any other") {
  MinimiseOptions options;
  options.lower.assign(3, -4);
  options.upper.assign(3, 4);
  options.target = 1e-6;
  const MinimiseResult result = Minimise(options, Population(
                                                      [](std::span<const double> x) {
                                                        if (x[0] > 1) return std::nan("");
                                                        return x[1] > 1 ? INFINITY : Sphere(x);
                                                      },
                                                      3));
  CHECK(result.best_cost < 1e-6);
}

TEST_CASE("minimise: bad options are refused by name") {
  const auto error = [](void (*change)(MinimiseOptions&)) {
    MinimiseOptions options;
    options.lower.assign(2, -1);
    options.upper.assign(2, 1);
    change(options);
    try {
      Minimise(options, Population(Sphere, 2));
    } catch (const InvalidInput& e) {
      return std::string(e.what());
    }
    return std::string();
  };
  CHECK(error([](MinimiseOptions& o) { o.lower.clear(); }) ==
        "Minimise: lower.size() = 0: must be at least 1");
  CHECK(error([](MinimiseOptions& o) { o.upper.push_back(1); }) ==
        "Minimise: upper.size() = 3: must be that of lower, 2");
  CHECK(error([](MinimiseOptions& o) { o.upper[1] = -1; }) ==
        "Minimise: upper[1] = -1: must be finite and above lower[1]");
  CHECK(error([](MinimiseOptions& o) { o.sigma = std::nan(""); }) ==
        "Minimise: sigma = nan: must be finite and > 0");
  CHECK(error([](MinimiseOptions& o) { o.population = 1; }) ==
        "Minimise: population = 1: must be 0 or at least 2");
  CHECK(error([](MinimiseOptions& o) { o.evaluations = 0; }) ==
        "Minimise: evaluations = 0: must be at least 1");
}

TEST_CASE("minimise: ask and tell are the same search, and asking twice changes nothing") {
  MinimiseOptions options;
  options.lower.assign(4, -4);
  options.upper.assign(4, 4);
  options.bounded = true;
  options.evaluations = 5000;
  const MinimiseResult wanted = Minimise(options, Population(Rastrigin, 4));
  Minimiser search(options);
  std::vector<double> costs;
  while (search.stop().empty()) {
    search.Ask();
    const std::span<const double> candidates = search.Ask();
    costs.resize(search.population());
    Population(Rastrigin, 4)(candidates, costs);
    search.Tell(costs);
  }
  CHECK(search.stop() == "budget");
  CHECK(search.result().best == wanted.best);
  CHECK(search.result().evaluations == wanted.evaluations);
  CHECK(search.result().runs.size() == wanted.runs.size());
  CHECK(search.run() > 1);
}

TEST_CASE("minimise: the first run begins where it is told to, its restarts do not") {
  MinimiseOptions options;
  options.lower.assign(3, -1e3);
  options.upper.assign(3, 1e3);
  options.start = {1, 2, 3};
  options.sigma = 1e-3;
  options.restarts = RestartStrategy::kSmall;
  options.evaluations = 4000;
  Minimiser search(options);
  CHECK(search.mean() == options.start);
  std::vector<double> costs;
  while (search.run() == 0) {
    const std::span<const double> candidates = search.Ask();
    costs.resize(search.population());
    Population(Sphere, 3)(candidates, costs);
    search.Tell(costs);
  }
  CHECK(search.mean() != options.start);
  options.start = {1, 2};
  CHECK_THROWS_AS(Minimiser{options}, InvalidInput);
  options.start = {1, 2, 2e3};
  options.bounded = true;
  CHECK_THROWS_AS(Minimiser{options}, InvalidInput);
}

}  // namespace
}  // namespace downpour
