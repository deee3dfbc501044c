// SPDX-License-Identifier: Apache-2.0
// Evaluations that CMA-ES needs on standard functions: median, quartiles and share solved over
// seeds, target 1e-8, first mean U[-4, 4]^P, first sigma 2, one run a seed unless the name says
// otherwise; large dimensions; final values under noise; the time that a generation takes.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "bench/program.h"
#include "engine/errors.h"
#include "engine/search/minimise.h"
#include "engine/search/search_run.h"
#include "tests/search/test_functions.h"

namespace downpour {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

struct Settings {
  std::vector<std::string> tables, functions;
  int seeds = 31;
  bool runs = false;
};

double Quantile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size()))];
}

// The optimum is the corner (0, ..., 0) of the box.
double Corner(std::span<const double> x) {
  double sum = 0;
  for (const double v : x) sum += 2 * v + v * v;
  return sum;
}

struct Row {
  std::string name;
  TestFunction function;
  int dimension;
  RestartStrategy restarts = RestartStrategy::kSingle;
  CovarianceForm covariance = CovarianceForm::kFull;
  bool bounded = false;
  std::int64_t evaluations = 3'000'000;
  int max_seeds = 1000;
  double hist_fun = CmaEsTolerances{}.hist_fun;  // TolHistFun
};

MinimiseResult RunSeed(const Row& row, std::uint64_t seed) {
  const auto p = static_cast<std::size_t>(row.dimension);
  MinimiseOptions options;
  options.lower.assign(p, row.bounded ? 0 : -4);
  options.upper.assign(p, 4);
  options.bounded = row.bounded;
  options.sigma = row.bounded ? 1 : 2;
  options.restarts = row.restarts;
  options.covariance = row.covariance;
  options.target = 1e-8;
  options.evaluations = row.evaluations;
  options.seed = seed;
  options.tolerances.hist_fun = row.hist_fun;
  return Minimise(options, [&](std::span<const double> candidates, std::span<double> costs) {
    for (std::size_t c = 0; c < costs.size(); ++c) {
      costs[c] = row.function(candidates.subspan(c * p, p));
    }
  });
}

void PrintRuns(const MinimiseResult& result) {
  for (const MinimiseRun& run : result.runs) {
    std::printf("    run %2d lambda %4d sigma %.3f evaluations %7lld best %.2e %s\n", run.plan.run,
                run.plan.population, run.plan.sigma, static_cast<long long>(run.evaluations),
                run.best_cost, run.stop.c_str());
  }
}

void PrintRow(const Row& row, const Settings& settings) {
  const int seeds = std::min(settings.seeds, row.max_seeds);
  std::vector<double> evaluations, costs;
  int solved = 0;
  const auto start = std::chrono::steady_clock::now();
  for (int seed = 1; seed <= seeds; ++seed) {
    const MinimiseResult result = RunSeed(row, static_cast<std::uint64_t>(seed));
    const bool reached = result.best_cost < 1e-8;
    evaluations.push_back(reached ? static_cast<double>(result.evaluations) : kInf);
    costs.push_back(result.best_cost);
    solved += reached;
    if (settings.runs) PrintRuns(result);
  }
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::printf("%-28s %5d %9.0f %9.0f %9.0f %5d/%d %9.1e %8.2f\n", row.name.c_str(), row.dimension,
              Quantile(evaluations, 0.25), Quantile(evaluations, 0.5), Quantile(evaluations, 0.75),
              solved, seeds, Quantile(costs, 0.5), seconds / seeds);
  std::fflush(stdout);
}

std::vector<Row> EvaluationRows() {
  struct Named {
    const char* name;
    TestFunction function;
  };
  const Named functions[] = {{"sphere", Sphere},
                             {"ellipsoid", Ellipsoid},
                             {"cigar", Cigar},
                             {"tablet", Tablet},
                             {"different powers", DifferentPowers},
                             {"Schwefel", Schwefel},
                             {"Griewank", Griewank},
                             {"Rosenbrock", Rosenbrock}};
  std::vector<Row> rows;
  for (const auto& [name, function] : functions) {
    for (const int dimension : {10, 20}) rows.push_back({name, function, dimension});
  }
  rows.push_back({"corner of a box", Corner, 10});
  rows.back().bounded = true;
  rows.push_back({"Rastrigin BIPOP", Rastrigin, 10, RestartStrategy::kBipop});
  // The tutorial's 1e-12 is a first guess; pycma stops at 1e-11; this is a tenth of the target.
  for (const auto& [name, tolerance] :
       {std::pair("Rastrigin BIPOP to 1e-11", 1e-11), std::pair("Rastrigin BIPOP to 1e-9", 1e-9)}) {
    rows.push_back(rows.back());
    rows.back().name = name;
    rows.back().hist_fun = tolerance;
  }
  rows.push_back({"Rastrigin IPOP", Rastrigin, 10, RestartStrategy::kIpop});
  return rows;
}

std::vector<Row> LargeRows() {
  constexpr auto kSingle = RestartStrategy::kSingle;
  constexpr auto kFull = CovarianceForm::kFull, kDiagonal = CovarianceForm::kDiagonal,
                 kLimited = CovarianceForm::kLimitedMemory;
  return {
      {"sphere full", Sphere, 100, kSingle, kFull, false, 2'000'000, 5},
      {"sphere diagonal", Sphere, 100, kSingle, kDiagonal, false, 2'000'000, 11},
      {"sphere limited memory", Sphere, 100, kSingle, kLimited, false, 2'000'000, 11},
      {"ellipsoid full", Ellipsoid, 100, kSingle, kFull, false, 2'000'000, 5},
      {"ellipsoid diagonal", Ellipsoid, 100, kSingle, kDiagonal, false, 2'000'000, 11},
      {"ellipsoid limited memory", Ellipsoid, 100, kSingle, kLimited, false, 4'000'000, 3},
      {"different powers full", DifferentPowers, 100, kSingle, kFull, false, 2'000'000, 5},
      {"different powers diagonal", DifferentPowers, 100, kSingle, kDiagonal, false, 2'000'000, 11},
      {"sphere limited memory", Sphere, 1000, kSingle, kLimited, false, 2'000'000, 5},
      {"cigar limited memory", Cigar, 1000, kSingle, kLimited, false, 2'000'000, 3},
      {"ellipsoid diagonal", Ellipsoid, 1000, kSingle, kDiagonal, false, 4'000'000, 3}};
}

// What the budget of an episode's search is enough for, on which CovarianceForm::kAuto rests.
std::vector<Row> BudgetRows() {
  std::vector<Row> rows;
  for (const int dimension : {100, 250, 500, 1000}) {
    for (const auto& [name, function] :
         {std::pair<std::string, TestFunction>{"ellipsoid", Ellipsoid},
          std::pair<std::string, TestFunction>{"Rosenbrock", Rosenbrock}}) {
      for (const auto& [form_name, form] :
           {std::pair(" full", CovarianceForm::kFull),
            std::pair(" limited memory", CovarianceForm::kLimitedMemory)}) {
        rows.push_back({name + form_name, function, dimension, RestartStrategy::kSingle, form,
                        false, 300'000, 1});
      }
    }
  }
  return rows;
}

// Mean return that SearchRun maximises: -f, disturbed.
struct Noise {
  const char* name;
  double additive, multiplicative;
};

// True value of the final mean of one run that spends the budget, whatever criterion it meets.
double FinalValue(const TestFunction& function, const Noise& noise, UncertaintyHandling handling,
                  std::uint64_t seed) {
  constexpr int kP = 10;
  constexpr std::int64_t kBudget = 30000;
  PolicySearchOptions options;
  options.bound = 1e6;
  options.uncertainty = handling;
  options.max_rollouts = 1000;
  options.covariance = CovarianceForm::kFull;
  // With common numbers all candidates of a generation would meet the same noise.
  options.common_random_numbers = CommonRandomNumbers::kOff;
  std::vector<double> mean(kP);
  FillUniforms(DeriveKey(seed, StreamPurpose::kSearchRestart, {0}), 1, mean.data(), kP);
  for (double& value : mean) value = 8 * value - 4;
  const RunPlan plan{0, Regime::kFirst, static_cast<int>(CmaEs::DefaultPopulation(kP)), 2};
  SearchRun run(options, plan, mean, seed, 0);
  SearchBatch batch;
  SearchRun* const runs[] = {&run};
  while (run.evaluations() + run.NextReturns() <= kBudget) {
    LayOut(runs, false, &batch);
    run.Ask(&batch);
    std::vector<double> normals;
    for (std::size_t c = 0, r = 0; c < batch.n_candidates; ++c) {
      normals.resize(static_cast<std::size_t>(batch.n_rollouts[c]));
      FillNormals(batch.keys[c], 0, normals.data(), normals.size());
      const double value = function({batch.parameters.data() + c * kP, kP});
      for (const double z : normals) {
        batch.returns[r++] = -(value * (1 + noise.multiplicative * z) + noise.additive * z);
      }
    }
    run.Tell(batch);
  }
  return function(run.Mean());
}

void PrintNoise(const Settings& settings) {
  std::printf("\n%-12s %-20s %-9s %10s %10s %10s\n", "final value", "noise", "handling", "quartile",
              "median", "quartile");
  const std::pair<const char*, TestFunction> functions[] = {{"sphere", Sphere},
                                                            {"Rosenbrock", Rosenbrock}};
  const Noise noises[] = {{"additive, std 1", 1, 0}, {"multiplicative, 0.3", 0, 0.3}};
  const std::pair<const char*, UncertaintyHandling> handlings[] = {
      {"off", UncertaintyHandling::kOff},
      {"sigma", UncertaintyHandling::kSigma},
      {"rollouts", UncertaintyHandling::kRollouts},
      {"lra", UncertaintyHandling::kLra}};
  for (const auto& [name, function] : functions) {
    for (const Noise& noise : noises) {
      for (const auto& [handling_name, handling] : handlings) {
        std::vector<double> values;
        for (int seed = 1; seed <= settings.seeds; ++seed) {
          values.push_back(FinalValue(function, noise, handling, static_cast<std::uint64_t>(seed)));
        }
        std::printf("%-12s %-20s %-9s %10.3g %10.3g %10.3g\n", name, noise.name, handling_name,
                    Quantile(values, 0.25), Quantile(values, 0.5), Quantile(values, 0.75));
        std::fflush(stdout);
      }
    }
  }
}

void PrintGenerationTime(int dimension, int population, CovarianceForm form) {
  constexpr int kGenerations = 300;
  const auto p = static_cast<std::size_t>(dimension);
  const auto lambda = static_cast<std::size_t>(population);
  std::vector<double> mean(p, 1.0), candidates(p * lambda), costs(lambda);
  double best_ask = 1e9, best_tell = 1e9;
  for (int repetition = 0; repetition < 3; ++repetition) {
    CmaEs cma(mean, 1, population, {.covariance = form});
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
  const char* const names[] = {"auto", "full", "diagonal", "limited memory"};
  std::printf("%-15s P = %4d, lambda = %3d: ask %5.0f us, tell %5.0f us a generation\n",
              names[static_cast<int>(form)], dimension, population, 1e6 * best_ask,
              1e6 * best_tell);
}

bool Wants(const Settings& settings, const char* table) {
  return std::find(settings.tables.begin(), settings.tables.end(), table) != settings.tables.end();
}

// Of the tables that list functions.
std::vector<Row> SelectRows(const Settings& settings) {
  std::vector<Row> rows;
  for (const auto& [table, table_rows] : {std::pair("evaluations", EvaluationRows()),
                                          {"large", LargeRows()},
                                          {"budget", BudgetRows()}}) {
    if (Wants(settings, table)) rows.insert(rows.end(), table_rows.begin(), table_rows.end());
  }
  if (settings.functions.empty()) return rows;
  const auto begins = [](const Row& row, const std::string& name) {
    return row.name.starts_with(name);
  };
  for (const std::string& name : settings.functions) {
    if (std::none_of(rows.begin(), rows.end(), [&](const Row& r) { return begins(r, name); })) {
      throw InvalidInput("--functions = " + name + ": must begin the name of a row, e.g. sphere");
    }
  }
  std::erase_if(rows, [&](const Row& row) {
    return std::none_of(settings.functions.begin(), settings.functions.end(),
                        [&](const std::string& name) { return begins(row, name); });
  });
  return rows;
}

void PrintTimes() {
  for (const int population : {16, 32}) PrintGenerationTime(71, population, CovarianceForm::kFull);
  for (const int dimension : {100, 250, 500, 1000}) {
    for (const CovarianceForm form :
         {CovarianceForm::kFull, CovarianceForm::kDiagonal, CovarianceForm::kLimitedMemory}) {
      PrintGenerationTime(dimension, static_cast<int>(CmaEs::DefaultPopulation(dimension)), form);
    }
  }
}

int Main(int argc, char** argv) {
  Settings settings;
  const std::vector<std::string> tables = {"evaluations", "large", "budget", "noise", "time"};
  settings.tables = tables;
  CLI::App app("Evaluations, noise and time of CMA-ES on standard functions");
  app.add_option("--tables", settings.tables, "which tables to print")
      ->delimiter(',')
      ->check(CLI::IsMember(tables))
      ->capture_default_str();
  app.add_option("--functions", settings.functions,
                 "rows of the first three tables whose names begin so; all if left out")
      ->delimiter(',');
  app.add_option("--seeds", settings.seeds, "seeds 1, 2, ...; large dimensions have fewer")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  app.add_flag("--runs", settings.runs, "a line a CMA-ES run too");
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp& help) {
    return app.exit(help);
  }

  const std::vector<Row> rows = SelectRows(settings);
  if (!rows.empty()) {
    std::printf("%-28s %5s %9s %9s %9s   %6s %9s %8s\n", "evaluations to 1e-8", "P", "quartile",
                "median", "quartile", "solved", "best cost", "s a seed");
  }
  for (const Row& row : rows) PrintRow(row, settings);
  if (Wants(settings, "noise")) PrintNoise(settings);
  if (Wants(settings, "time")) PrintTimes();
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("search_bench", downpour::Main, argc, argv);
}
