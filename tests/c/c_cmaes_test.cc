// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <limits>

#include "engine/search/minimise.h"
#include "tests/c/c_fixture.h"

namespace downpour {
namespace {

using CCmaes = std::unique_ptr<downpour_cmaes, decltype(&downpour_cmaes_destroy)>;

CCmaes MakeCmaes(const std::vector<double>& start, double sigma,
                 const downpour_cmaes_options* options) {
  downpour_cmaes* cmaes = nullptr;
  const int status =
      downpour_cmaes_create(start.data(), static_cast<int>(start.size()), sigma, options, &cmaes);
  REQUIRE_MESSAGE(status == DOWNPOUR_OK, downpour_last_error());
  return {cmaes, &downpour_cmaes_destroy};
}

double Ellipsoid(const double* x, std::size_t n) {
  double sum = 0;
  for (std::size_t i = 0; i < n; ++i) sum += std::pow(10.0, i) * x[i] * x[i];
  return sum;
}

TEST_CASE("C CMA-ES: ask and tell give the bits of Minimise") {
  const std::vector<double> start = {2, -1, 0.5}, lower(3, -3), upper(3, 3);
  downpour_cmaes_options options;
  downpour_cmaes_options_init(&options);
  options.lower = lower.data();
  options.upper = upper.data();
  options.target = 1e-10;
  options.seed = 11;
  const CCmaes cmaes = MakeCmaes(start, 0.5, &options);
  std::string stop;
  while (stop.empty()) {
    int population = 0;
    REQUIRE(downpour_cmaes_population(cmaes.get(), &population) == DOWNPOUR_OK);
    std::vector<double> candidates(population * 3), again(population * 3), costs(population);
    REQUIRE(downpour_cmaes_ask(cmaes.get(), population, candidates.data()) == DOWNPOUR_OK);
    REQUIRE(downpour_cmaes_ask(cmaes.get(), population, again.data()) == DOWNPOUR_OK);
    REQUIRE(candidates == again);
    for (int c = 0; c < population; ++c) costs[c] = Ellipsoid(&candidates[3 * c], 3);
    REQUIRE(downpour_cmaes_tell(cmaes.get(), population, costs.data()) == DOWNPOUR_OK);
    const char* text = nullptr;
    REQUIRE(downpour_cmaes_stop(cmaes.get(), &text) == DOWNPOUR_OK);
    stop = text;
  }
  CHECK(stop == "target");
  MinimiseOptions cpp;
  cpp.lower = lower;
  cpp.upper = upper;
  cpp.bounded = true;
  cpp.start = start;
  cpp.sigma = 0.5;
  cpp.target = 1e-10;
  cpp.seed = 11;
  const MinimiseResult wanted =
      Minimise(cpp, [](std::span<const double> candidates, std::span<double> costs) {
        for (std::size_t c = 0; c < costs.size(); ++c) costs[c] = Ellipsoid(&candidates[3 * c], 3);
      });
  std::vector<double> best(3);
  double cost = 0;
  std::int64_t evaluations = 0;
  CHECK(downpour_cmaes_best(cmaes.get(), best.data(), &cost, &evaluations) == DOWNPOUR_OK);
  CHECK(best == wanted.best);
  CHECK(cost == wanted.best_cost);
  CHECK(evaluations == wanted.evaluations);
}

TEST_CASE("C CMA-ES: calls that are wrong are told and change nothing") {
  const CCmaes cmaes = MakeCmaes({1, 1}, 1, nullptr);
  std::vector<double> room(1000), costs(100, 1.0);
  int population = 0;
  REQUIRE(downpour_cmaes_population(cmaes.get(), &population) == DOWNPOUR_OK);
  const int bad = DOWNPOUR_INVALID_INPUT;
  CheckFailure(downpour_cmaes_best(cmaes.get(), room.data(), nullptr, nullptr), bad,
               "nothing was told");
  CheckFailure(downpour_cmaes_tell(cmaes.get(), population, costs.data()), bad,
               "nothing was asked");
  CheckFailure(downpour_cmaes_ask(cmaes.get(), population + 1, room.data()), bad, "population = ");
  CheckFailure(downpour_cmaes_ask(cmaes.get(), population, nullptr), bad, "candidates: NULL");
  CheckFailure(downpour_cmaes_ask(nullptr, population, room.data()), bad, "cmaes: NULL");
  REQUIRE(downpour_cmaes_ask(cmaes.get(), population, room.data()) == DOWNPOUR_OK);
  CheckFailure(downpour_cmaes_tell(cmaes.get(), population, nullptr), bad, "costs: NULL");
  CheckFailure(downpour_cmaes_tell(cmaes.get(), 2, costs.data()), bad, "population = 2");
  costs[0] = std::numeric_limits<double>::quiet_NaN();
  CHECK(downpour_cmaes_tell(cmaes.get(), population, costs.data()) == DOWNPOUR_OK);
  CheckFailure(downpour_cmaes_stop(cmaes.get(), nullptr), bad, "stop: NULL");
}

TEST_CASE("C CMA-ES: options that are wrong are told") {
  downpour_cmaes* made = nullptr;
  const double start[] = {0, 0}, lower[] = {-1, 1}, upper[] = {1, 1}, outside[] = {2, 2};
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto fails = [&](const char* message, const auto& change) {
    downpour_cmaes_options options;
    downpour_cmaes_options_init(&options);
    change(&options);
    CheckFailure(downpour_cmaes_create(start, 2, 1, &options, &made), DOWNPOUR_INVALID_INPUT,
                 message);
  };
  using Options = downpour_cmaes_options;
  fails("options: size", [](Options* o) { o->size = 0; });
  fails("must both be given", [&](Options* o) { o->lower = lower; });
  fails("upper[1]", [&](Options* o) { o->lower = lower, o->upper = upper; });
  fails("start[0]", [&](Options* o) { o->lower = upper, o->upper = outside; });
  fails("options.restarts = 9", [](Options* o) { o->restarts = 9; });
  fails("population = 1", [](Options* o) { o->population = 1; });
  fails("options.population = -1", [](Options* o) { o->population = -1; });
  fails("evaluations = 0", [](Options* o) { o->evaluations = 0; });
  fails("options.target = nan", [&](Options* o) { o->target = nan; });
  const int bad = DOWNPOUR_INVALID_INPUT;
  CheckFailure(downpour_cmaes_create(nullptr, 2, 1, nullptr, &made), bad, "start: NULL");
  CheckFailure(downpour_cmaes_create(&nan, 1, 1, nullptr, &made), bad, "start[0] = nan");
  CheckFailure(downpour_cmaes_create(start, 0, 1, nullptr, &made), bad, "n_parameters = 0");
  CheckFailure(downpour_cmaes_create(start, 2, 0, nullptr, &made), bad, "sigma = 0");
  CheckFailure(downpour_cmaes_create(start, 2, nan, nullptr, &made), bad, "sigma = nan");
  CheckFailure(downpour_cmaes_create(start, 2, 1, nullptr, nullptr), bad, "cmaes: NULL");
  CHECK(made == nullptr);
}

}  // namespace
}  // namespace downpour
