// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/search/bipop.h"
#include "engine/search/cma_es.h"
#include "tests/search/test_functions.h"

namespace downpour {
namespace {

using Numbers = std::vector<double>;

// The same bits, not just the same values.
bool SameBits(const Numbers& a, const Numbers& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(double)) == 0;
}

void Generation(CmaEs& cma, const TestFunction& function, std::uint32_t run, Numbers* candidates) {
  const auto p = static_cast<std::size_t>(cma.dimension());
  Numbers costs(static_cast<std::size_t>(cma.population()));
  candidates->resize(p * costs.size());
  const auto g = static_cast<std::uint32_t>(cma.generation());
  cma.Ask(DeriveKey(6, StreamPurpose::kSearchSampling, {run, g}), *candidates);
  for (std::size_t c = 0; c < costs.size(); ++c) {
    costs[c] = function({candidates->data() + c * p, p});
  }
  cma.Tell(costs);
}

TEST_CASE("save_restore: a run restored at any generation goes on with the same bits") {
  for (const CovarianceForm form :
       {CovarianceForm::kFull, CovarianceForm::kDiagonal, CovarianceForm::kLimitedMemory}) {
    for (const bool adapts : {false, true}) {
      if (adapts && form == CovarianceForm::kLimitedMemory) continue;
      CmaEsTolerances tolerances;
      tolerances.hist_fun = 1e-9;
      CmaEs cma(Numbers(6, 1.7), 0.5, 9, {tolerances, form, adapts});
      CmaEs restored = cma;
      Numbers x, y;
      while (cma.stop().empty() && cma.generation() < 3000) {
        // The one that goes on has been restored in every generation so far.
        restored = CmaEs::Restore(restored.Save(), tolerances);
        Generation(cma, Rosenbrock, 0, &x);
        Generation(restored, Rosenbrock, 0, &y);
        REQUIRE(SameBits(x, y));
        REQUIRE(SameBits(cma.Save(), restored.Save()));
        REQUIRE(cma.stop() == restored.stop());
      }
      CHECK(CmaEs::Restore(cma.Save()).stop() == cma.stop());
      if (form == CovarianceForm::kFull && !adapts) CHECK(cma.stop() == "TolHistFun");
    }
  }
}

TEST_CASE("save_restore: the history that Stagnation reads is part of the state") {
  const auto scrambled = [](std::span<const double> x) { return std::sin(1e9 * x[0]); };
  const CmaEsTolerances off{0, 0, 1e300, 1e300};
  CmaEs cma(Numbers(3, 1.0), 1, 8, {.tolerances = off});
  CmaEs restored = cma;
  Numbers x;
  while (cma.stop().empty() && cma.generation() < 5000) {
    restored = CmaEs::Restore(restored.Save(), off);
    Generation(cma, scrambled, 0, &x);
    Generation(restored, scrambled, 0, &x);
    REQUIRE(cma.stop() == restored.stop());
  }
  CHECK(cma.stop() == "Stagnation");
}

// All candidates of a search with restarts; `restores` before every generation.
Numbers Search(RestartStrategy strategy, bool restores) {
  const auto scheduler_of = [&] { return RestartScheduler(strategy, 8, 1000, 2, 2); };
  RestartScheduler scheduler = scheduler_of();
  RunPlan plan = scheduler.First(2);
  Numbers all, x;
  for (int run = 0; run < 8; ++run) {
    CmaEs cma(Numbers(3, 3.3), plan.sigma, plan.population);
    std::int64_t evaluations = 0;
    while (cma.stop().empty() && !scheduler.IsExhausted(plan, evaluations)) {
      if (restores) {
        const Numbers state = scheduler.Save();
        scheduler = scheduler_of();
        scheduler.Restore(state);
        cma = CmaEs::Restore(cma.Save());
      }
      Generation(cma, Rastrigin, static_cast<std::uint32_t>(run), &x);
      scheduler.Add(plan, plan.population);
      evaluations += plan.population;
      all.insert(all.end(), x.begin(), x.end());
    }
    scheduler.End(plan);
    plan = scheduler.Next(0.3 + 0.05 * run, 0.1 * run);
  }
  return all;
}

TEST_CASE("save_restore: a search with restarts, restored in every generation, has the same bits") {
  for (const RestartStrategy strategy :
       {RestartStrategy::kBipop, RestartStrategy::kSmall, RestartStrategy::kIpop}) {
    CHECK(SameBits(Search(strategy, false), Search(strategy, true)));
  }
}

template <typename Function>
std::string ErrorOf(Function function) {
  try {
    function();
  } catch (const InvalidInput& error) {
    return error.what();
  }
  return "";
}

TEST_CASE("save_restore: what was not saved is refused") {
  CmaEs cma(Numbers(3, 1.0), 1, 6);
  Numbers x;
  for (int g = 0; g < 5; ++g) Generation(cma, Sphere, 0, &x);
  const Numbers state = cma.Save();
  const auto error = [](const Numbers& numbers) {
    return ErrorOf([&] { CmaEs::Restore(numbers); });
  };
  CHECK(error(state) == "");
  for (std::size_t n = 0; n < state.size(); ++n) {
    CHECK(error(Numbers(state.begin(), state.begin() + static_cast<std::ptrdiff_t>(n))) != "");
  }
  Numbers longer = state;
  longer.push_back(0);
  CHECK(error(longer) == "CMA-ES: a state of " + std::to_string(longer.size()) +
                             " numbers is longer than that: must be one that was saved");
  for (const double bad : {-1.0, 0.5, 1e300, std::numeric_limits<double>::quiet_NaN()}) {
    for (std::size_t k = 0; k < 4; ++k) {  // form, P, lambda, whether rates adapt
      Numbers changed = state;
      changed[k] = bad;
      CHECK(error(changed) != "");
    }
  }
  RestartScheduler scheduler(RestartStrategy::kBipop, 8, 100, 1, 1);
  CHECK(ErrorOf([&] { scheduler.Restore(state); }) != "");
}

}  // namespace
}  // namespace downpour
