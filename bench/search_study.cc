// SPDX-License-Identifier: Apache-2.0
// How good are the policies that the search finds on one fixed model? Learns the dynamics model of
// a run's first episodes once, then searches with several seeds and prints, a line a search, the
// predicted return found, and with --runs every CMA-ES run's final mean.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "bench/program.h"
#include "bench/run_data.h"
#include "engine/gp/gp_model.h"
#include "engine/rollout/evaluator.h"
#include "engine/search/policy_search.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

int Main(int argc, char** argv) {
  std::string task_name;
  std::filesystem::path run;
  int episodes = 4, seeds = 8, threads = 2;
  bool print_runs = false;
  std::string restarts = "small", uncertainty = "off";
  CLI::App app("Searches on one fixed model, over seeds");
  PolicySearchOptions options;
  app.add_option("task", task_name)->required();
  app.add_option("run", run, "run directory that holds the data")->required();
  app.add_option("--episodes", episodes, "the model learns from so many");
  app.add_option("--seeds", seeds);
  app.add_option("--threads", threads);
  app.add_option("--evaluations", options.evaluations);
  app.add_option("--population", options.population);
  app.add_option("--rollouts", options.rollouts);
  app.add_option("--concurrent", options.concurrent);
  auto* const first_sigma = app.add_option("--first-sigma", options.first_sigma);
  auto* const restart_sigma = app.add_option("--restart-sigma", options.restart_sigma);
  auto* const restart_decades = app.add_option("--restart-decades", options.restart_decades);
  app.add_option("--exploration", options.exploration);
  app.add_option("--restarts", restarts)
      ->check(CLI::IsMember({"bipop", "small", "ipop", "single"}));
  app.add_option("--uncertainty", uncertainty)
      ->check(CLI::IsMember({"off", "sigma", "rollouts", "lra"}));
  app.add_flag("--runs", print_runs, "a line a CMA-ES run");
  CLI11_PARSE(app, argc, argv);

  const Task task = MakeTask(task_name);
  if (first_sigma->empty()) options.first_sigma = task.search_first_sigma;
  if (restart_sigma->empty()) options.restart_sigma = task.search_restart_sigma;
  if (restart_decades->empty()) options.restart_decades = task.search_restart_decades;
  options.bound = task.parameter_bound;
  options.restarts = restarts == "bipop"   ? RestartStrategy::kBipop
                     : restarts == "small" ? RestartStrategy::kSmall
                     : restarts == "ipop"  ? RestartStrategy::kIpop
                                           : RestartStrategy::kSingle;
  options.uncertainty = uncertainty == "off"     ? UncertaintyHandling::kOff
                        : uncertainty == "sigma" ? UncertaintyHandling::kSigma
                        : uncertainty == "lra"   ? UncertaintyHandling::kLra
                                                 : UncertaintyHandling::kRollouts;
  const Dataset data = ReadDataset(task, {&run, 1}, episodes);
  std::vector<QueryFactor> factors;
  const auto fits = FitHyperparameters(data, {}, {}, 0, 0, threads);
  for (int e = 0; e < data.n_outputs(); ++e) {
    factors.push_back(ExactGp(data.inputs, data.targets.col(e), fits[e].hyperparameters).Pack());
  }
  const auto policy = MakeNeuralNetworkPolicy(task, 10);
  EvaluatorOptions evaluator_options;
  evaluator_options.threads = threads;
  std::vector<double> found;
  for (int seed = 0; seed < seeds; ++seed) {
    Evaluator evaluator(task, *policy, factors, evaluator_options);
    const PolicySearchResult result = SearchPolicy(
        options, std::vector<double>(policy->n_parameters(), 0.0), seed, 1,
        [&](const CandidateBatch& batch, std::span<double> returns) {
          evaluator.Evaluate(batch.parameters, batch.keys, batch.n_rollouts, batch.first_rollout,
                             returns);
        },
        {}, nullptr);
    found.push_back(result.predicted_return);
    std::printf("seed %d: return %.2f, %lld rollouts, %zu runs\n", seed, result.predicted_return,
                static_cast<long long>(result.evaluations), result.runs.size());
    for (const RunRecord& r : result.runs) {
      if (!print_runs) break;
      std::printf("  run %d: lambda %d sigma %.3f rollouts %lld stop %s return %.2f\n", r.run,
                  r.population, r.initial_sigma, static_cast<long long>(r.evaluations),
                  r.stop.c_str(), r.mean_return);
    }
    std::fflush(stdout);
  }
  std::sort(found.begin(), found.end());
  std::printf("n = %d, sorted:", data.n_points());
  for (const double value : found) std::printf(" %.1f", value);
  std::printf("\n");
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("search_study", downpour::Main, argc, argv);
}
