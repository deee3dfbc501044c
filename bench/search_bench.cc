// SPDX-License-Identifier: Apache-2.0
// Evaluations that CMA-ES needs on standard functions: median, quartiles and share solved over 31
// seeds, target 1e-8, first mean U[-4, 4]^P, first sigma 2. Rastrigin is restarted by BIPOP. With
// it, the time that one generation takes at the size of a cart-pole policy.
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <vector>

#include "engine/gp/process_settings.h"
#include "engine/search/bipop.h"
#include "engine/search/cma_es.h"
#include "tests/search/test_functions.h"

namespace downpour {
namespace {

constexpr int kSeeds = 31;
constexpr double kTarget = 1e-8;
constexpr double kSigma = 2;

struct Outcome {
  std::int64_t evaluations = 0;
  bool solved = false;
};

// One run until the target, a stopping criterion or the share of a small run.
Outcome RunOnce(const TestFunction& function, int dimension, std::uint32_t seed,
                const RunPlan& plan, RestartScheduler& scheduler, std::int64_t max_evaluations) {
  const auto run = static_cast<std::uint32_t>(plan.run);
  const auto p = static_cast<std::size_t>(dimension);
  std::vector<double> mean(p);
  FillUniforms(DeriveKey(seed, StreamPurpose::kSearchRestart, {run}), 1, mean.data(), p);
  for (double& value : mean) value = 8 * value - 4;
  CmaEs cma(mean, plan.sigma, plan.population);
  std::vector<double> candidates(p * static_cast<std::size_t>(plan.population));
  std::vector<double> costs(static_cast<std::size_t>(plan.population));
  Outcome outcome;
  while (cma.stop().empty() && outcome.evaluations < max_evaluations &&
         !scheduler.IsExhausted(plan, outcome.evaluations)) {
    const auto generation = static_cast<std::uint32_t>(cma.generation());
    cma.Ask(DeriveKey(seed, StreamPurpose::kSearchSampling, {run, generation}), candidates);
    for (std::size_t c = 0; c < costs.size(); ++c) {
      costs[c] = function({candidates.data() + c * p, p});
      ++outcome.evaluations;
      if (costs[c] < kTarget) {
        outcome.solved = true;
        return outcome;
      }
    }
    cma.Tell(costs);
    scheduler.Add(plan, plan.population);
  }
  return outcome;
}

Outcome RunSeed(const TestFunction& function, int dimension, std::uint32_t seed, bool restarts,
                std::int64_t max_evaluations) {
  RestartScheduler scheduler(RestartStrategy::kBipop, CmaEs::DefaultPopulation(dimension), 1 << 20,
                             kSigma, 2);
  RunPlan plan = scheduler.First(kSigma);
  Outcome total;
  while (true) {
    const Outcome run =
        RunOnce(function, dimension, seed, plan, scheduler, max_evaluations - total.evaluations);
    total.evaluations += run.evaluations;
    total.solved = run.solved;
    scheduler.End(plan);
    if (!restarts || total.solved || total.evaluations >= max_evaluations) return total;
    double draws[2];
    FillUniforms(
        DeriveKey(seed, StreamPurpose::kSearchRestart, {static_cast<std::uint32_t>(plan.run) + 1}),
        0, draws, 2);
    plan = scheduler.Next(draws[0], draws[1]);
  }
}

void PrintRow(const char* name, const TestFunction& function, int dimension, bool restarts) {
  std::vector<std::int64_t> evaluations;
  int solved = 0;
  for (std::uint32_t seed = 1; seed <= kSeeds; ++seed) {
    const Outcome outcome = RunSeed(function, dimension, seed, restarts, 3'000'000);
    evaluations.push_back(outcome.evaluations);
    solved += outcome.solved;
  }
  std::sort(evaluations.begin(), evaluations.end());
  std::printf("%-18s %3d %10lld %10lld %10lld   %d/%d\n", name, dimension,
              static_cast<long long>(evaluations[kSeeds / 4]),
              static_cast<long long>(evaluations[kSeeds / 2]),
              static_cast<long long>(evaluations[3 * kSeeds / 4]), solved, kSeeds);
}

void PrintGenerationTime(int dimension, int population) {
  constexpr int kGenerations = 300;
  const auto p = static_cast<std::size_t>(dimension);
  const auto lambda = static_cast<std::size_t>(population);
  std::vector<double> mean(p, 1.0), candidates(p * lambda), costs(lambda);
  double best_ask = 1e9, best_tell = 1e9;
  for (int repetition = 0; repetition < 5; ++repetition) {
    CmaEs cma(mean, 1, population);
    double ask = 0, tell = 0;
    for (std::uint32_t g = 0; g < kGenerations; ++g) {
      const auto t0 = std::chrono::steady_clock::now();
      cma.Ask(DeriveKey(0, StreamPurpose::kSearchSampling, {g}), candidates);
      const auto t1 = std::chrono::steady_clock::now();
      for (std::size_t c = 0; c < lambda; ++c) costs[c] = Sphere({candidates.data() + c * p, p});
      const auto t2 = std::chrono::steady_clock::now();
      cma.Tell(costs);
      tell += std::chrono::duration<double>(std::chrono::steady_clock::now() - t2).count();
      ask += std::chrono::duration<double>(t1 - t0).count();
    }
    best_ask = std::min(best_ask, ask / kGenerations);
    best_tell = std::min(best_tell, tell / kGenerations);
  }
  std::printf("P = %d, lambda = %d: ask %.0f us, tell %.0f us a generation\n", dimension,
              population, 1e6 * best_ask, 1e6 * best_tell);
}

}  // namespace
}  // namespace downpour

int main(int, char** argv) {
  using namespace downpour;
  PrepareProcess(argv);
  std::printf("%-18s %3s %10s %10s %10s   %s\n", "evaluations", "P", "quartile", "median",
              "quartile", "solved");
  PrintRow("sphere", Sphere, 10, false);
  PrintRow("sphere", Sphere, 20, false);
  PrintRow("ellipsoid", Ellipsoid, 10, false);
  PrintRow("ellipsoid", Ellipsoid, 20, false);
  PrintRow("Rosenbrock", Rosenbrock, 10, false);
  PrintRow("Rosenbrock", Rosenbrock, 20, false);
  PrintRow("Rastrigin (BIPOP)", Rastrigin, 10, true);
  PrintGenerationTime(71, 16);
  PrintGenerationTime(71, 32);
  return 0;
}
