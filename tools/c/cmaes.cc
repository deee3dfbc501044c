// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <limits>
#include <span>
#include <string>
#include <utility>

#include "engine/search/minimise.h"
#include "tools/c/downpour.h"
#include "tools/c/status.h"

struct downpour_cmaes {
  downpour::Minimiser search;
  bool asked = false;  // and not told since
  std::string stop;    // as a C string
};

namespace downpour::c {
namespace {

// In the order of the constants.
constexpr RestartStrategy kRestarts[] = {RestartStrategy::kBipop, RestartStrategy::kSmall,
                                         RestartStrategy::kIpop, RestartStrategy::kSingle};

// Where restarts begin and, if the caller has given bounds, candidates stay.
void SetBounds(const downpour_cmaes_options& given, MinimiseOptions* options) {
  if ((given.lower == nullptr) != (given.upper == nullptr)) {
    throw InvalidInput("options.lower, options.upper: must both be given, or none");
  }
  options->bounded = given.lower != nullptr;
  if (options->bounded) {
    options->lower.assign(given.lower, given.lower + options->start.size());
    options->upper.assign(given.upper, given.upper + options->start.size());
    return;
  }
  for (const double x : options->start) {
    options->lower.push_back(x - options->sigma);
    options->upper.push_back(x + options->sigma);
  }
}

// Minimiser checks the numbers.
MinimiseOptions ToOptions(const double* start, int n_parameters, double sigma,
                          const downpour_cmaes_options* given) {
  const downpour_cmaes_options from = OptionsOr(downpour_cmaes_options_init, given);
  RequireRange("n_parameters", n_parameters, 1, 1e6);
  MinimiseOptions options;
  const std::span<const double> numbers = Numbers(start, n_parameters, "start");
  RequireFinite(numbers, "start");
  options.start.assign(numbers.begin(), numbers.end());
  RequireRange("sigma", sigma, 1e-150, 1e150);
  options.sigma = sigma;
  SetBounds(from, &options);
  RequireRange("options.restarts", from.restarts, DOWNPOUR_RESTARTS_BIPOP, DOWNPOUR_RESTARTS_NONE);
  options.restarts = kRestarts[from.restarts];
  RequireRange("options.population", from.population, 0, 1 << 20);
  options.population = from.population;
  options.evaluations = from.evaluations;
  RequireRange("options.target", from.target, -std::numeric_limits<double>::infinity(),
               std::numeric_limits<double>::infinity());
  options.target = from.target;
  options.seed = from.seed;
  return options;
}

downpour_cmaes& Get(downpour_cmaes* cmaes) {
  RequireSet(cmaes, "cmaes");
  return *cmaes;
}

const downpour_cmaes& Get(const downpour_cmaes* cmaes) {
  RequireSet(cmaes, "cmaes");
  return *cmaes;
}

void RequireRunning(const downpour_cmaes& cmaes) {
  if (cmaes.stop.empty()) return;
  throw InvalidInput("cmaes: the search has stopped (" + cmaes.stop + ")");
}

std::size_t RequirePopulation(const downpour_cmaes& cmaes, int population) {
  if (population == cmaes.search.population()) return population;
  throw InvalidInput("population = " + std::to_string(population) + ": must be " +
                     std::to_string(cmaes.search.population()));
}

}  // namespace
}  // namespace downpour::c

using namespace downpour;     // NOLINT: the functions are C's
using namespace downpour::c;  // NOLINT

int downpour_cmaes_options_init(downpour_cmaes_options* options) {
  return InitOptions(options, [](downpour_cmaes_options& to) {
    const MinimiseOptions defaults;
    to.restarts = DOWNPOUR_RESTARTS_BIPOP;
    to.evaluations = defaults.evaluations;
    to.target = defaults.target;
  });
}

int downpour_cmaes_create(const double* start, int n_parameters, double sigma,
                          const downpour_cmaes_options* options, downpour_cmaes** cmaes) {
  return Guard([&] {
    RequireSet(cmaes, "cmaes");
    Minimiser search(ToOptions(start, n_parameters, sigma, options));
    std::string stop(search.stop());
    *cmaes = new downpour_cmaes{std::move(search), false, std::move(stop)};
  });
}

void downpour_cmaes_destroy(downpour_cmaes* cmaes) { delete cmaes; }

int downpour_cmaes_population(const downpour_cmaes* cmaes, int* population) {
  return Guard([&] {
    const downpour_cmaes& of = Get(cmaes);
    RequireSet(population, "population");
    *population = of.search.population();
  });
}

int downpour_cmaes_ask(downpour_cmaes* cmaes, int population, double* candidates) {
  return Guard([&] {
    downpour_cmaes& of = Get(cmaes);
    RequireRunning(of);
    const std::size_t n = RequirePopulation(of, population) * of.search.dimension();
    const std::span<double> room = Room(candidates, n, "candidates");
    const std::span<const double> asked = of.search.Ask();
    std::copy(asked.begin(), asked.end(), room.begin());
    of.asked = true;
  });
}

int downpour_cmaes_tell(downpour_cmaes* cmaes, int population, const double* costs) {
  return Guard([&] {
    downpour_cmaes& of = Get(cmaes);
    RequireRunning(of);
    const auto numbers = Numbers(costs, RequirePopulation(of, population), "costs");
    if (!of.asked) throw InvalidInput("cmaes: nothing was asked: ask must come before tell");
    of.asked = false;
    of.search.Tell(numbers);
    of.stop = of.search.stop();
  });
}

int downpour_cmaes_stop(const downpour_cmaes* cmaes, const char** stop) {
  return Guard([&] {
    const downpour_cmaes& of = Get(cmaes);
    RequireSet(stop, "stop");
    *stop = of.stop.c_str();
  });
}

int downpour_cmaes_best(const downpour_cmaes* cmaes, double* candidate, double* cost,
                        int64_t* evaluations) {
  return Guard([&] {
    const MinimiseResult& result = Get(cmaes).search.result();
    if (result.best.empty()) throw InvalidInput("cmaes: nothing was told: tell must come before");
    if (candidate != nullptr) std::copy(result.best.begin(), result.best.end(), candidate);
    if (cost != nullptr) *cost = result.best_cost;
    if (evaluations != nullptr) *evaluations = result.evaluations;
  });
}
