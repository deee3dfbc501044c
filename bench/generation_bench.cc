// SPDX-License-Identifier: Apache-2.0
// How well a policy search fills the machine: lambda = 16, one rollout a candidate, on a cart-pole
// model. Prints, by the default plan and by exact fp64, the share of the time outside the
// evaluator, lane fill and idle threads, of the whole search and of its rounds, and how much
// faster it is by several threads than by one, beside what the machine's FMA peak gains.
//   generation_bench RUN [--episodes N] [--threads N]
// RUN is a run directory of cart-pole; its first N episodes are the data (40 points each).
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "bench/program.h"
#include "bench/run_data.h"
#include "engine/gp/gp_model.h"
#include "engine/learner/plan_probes.h"
#include "engine/learner/planned_model.h"
#include "engine/learner/rollout_objective.h"
#include "engine/rollout/evaluator.h"
#include "engine/search/policy_search.h"
#include "tasks/registry.h"
#include "tools/measure/ceilings.h"

namespace downpour {
namespace {

constexpr std::uint64_t kSeed = 1;
constexpr std::uint32_t kEpisode = 2;

struct Settings {
  std::filesystem::path run;
  int episodes = 4;
  int threads = 2;
  int repetitions = 5;
  PolicySearchOptions search;
};

struct SearchTimes {
  double seconds = std::numeric_limits<double>::infinity();
  EvaluatorStatistics statistics;
  std::vector<double> lane_fills, idle_shares;  // of every round
  PolicySearchResult result;
};

double Quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1))];
}

SearchTimes Search(const Task& task, const Policy& policy, const PlannedModel& model,
                   PolicySearchOptions options, int threads) {
  options.threads = threads;
  options.relaxed_exploration = false;  // as for every search but the first
  SearchTimes times;
  RolloutObjective objective(task, policy, model.factors(), {.threads = threads});
  const std::vector<double> origin(policy.n_parameters(), 0.0);
  EvaluatorStatistics before;
  const auto start = std::chrono::steady_clock::now();
  times.result = SearchPolicy(
      options, origin, kSeed, kEpisode,
      [&](const CandidateBatch& batch, std::span<double> returns) {
        objective.Evaluate(batch, returns);
      },
      [&](const PolicySearchProgress& now) {
        times.statistics = objective.Statistics(now.waiting_seconds);
        const EvaluatorStatistics round = times.statistics.Since(before);
        times.lane_fills.push_back(round.LaneFill());
        times.idle_shares.push_back(round.IdleShare(threads));
        before = times.statistics;
      },
      nullptr, objective.own_objectives());
  times.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return times;
}

void Print(const SearchTimes& times, int threads) {
  const EvaluatorStatistics& s = times.statistics;
  std::printf(
      "%d thread%s: %.3f s, %.1f ns a query; outside of the evaluator %.2f %% of the time "
      "(%zu rounds)\n",
      threads, threads == 1 ? " " : "s", times.seconds,
      1e9 * times.seconds / static_cast<double>(s.gp_queries),
      100 * (1 - s.seconds / times.seconds), times.lane_fills.size());
  std::printf(
      "  lane fill %.1f %% (least of a round %.1f %%), idle threads %.2f %% (a round: median %.2f "
      "%%, 95 %% below %.2f %%)\n",
      100 * s.LaneFill(), 100 * Quantile(times.lane_fills, 0), 100 * s.IdleShare(threads),
      100 * Quantile(times.idle_shares, 0.5), 100 * Quantile(times.idle_shares, 0.95));
}

void PrintPlan(const char* name, const PlannedModel& model) {
  std::printf("\n%s:", name);
  const std::vector<double> nanoseconds = model.TimeQueries();
  for (std::size_t e = 0; e < nanoseconds.size(); ++e) {
    const OutputPlan& plan = model.plans()[e];
    std::printf(" %d %s %.0f ns%s", plan.points, plan.single_precision ? "fp32" : "fp64",
                nanoseconds[e], e + 1 < nanoseconds.size() ? "," : "");
  }
  std::printf(" of %d points\n", model.plans()[0].n);
}

// One thread and several take turns; the best of each.
void Compare(const Task& task, const Policy& policy, const PlannedModel& model,
             const Settings& settings) {
  SearchTimes one, all;
  double peak_one = 0, peak_all = 0;
  for (int repetition = 0; repetition < settings.repetitions; ++repetition) {
    for (const bool alone : {true, false}) {
      const int threads = alone ? 1 : settings.threads;
      double& peak = alone ? peak_one : peak_all;
      peak = std::max(peak, FmaPeakTogether(threads));
      SearchTimes times = Search(task, policy, model, settings.search, threads);
      SearchTimes& best = alone ? one : all;
      if (times.seconds < best.seconds) best = std::move(times);
    }
  }
  if (one.result.parameters != all.result.parameters) {
    throw std::runtime_error("the number of threads changed the result");
  }
  Print(one, 1);
  Print(all, settings.threads);
  std::printf("%d threads: %.2f x as fast as one, FMA peak %.1f GFLOP/s, %.2f x\n",
              settings.threads, one.seconds / all.seconds, peak_all, peak_all / peak_one);
}

int Main(int argc, char** argv) {
  Settings settings;
  settings.search.population = 16;
  settings.search.evaluations = 60000;
  CLI::App app("How well a policy search fills the machine");
  app.add_option("run", settings.run, "run directory of cart-pole")->required();
  app.add_option("--episodes", settings.episodes)->check(CLI::Range(1, 1000));
  app.add_option("--threads", settings.threads)->check(CLI::Range(2, 1024));
  app.add_option("--repetitions", settings.repetitions)->check(CLI::Range(1, 1000));
  app.add_option("--population", settings.search.population)->check(CLI::Range(2, 100000));
  app.add_option("--concurrent", settings.search.concurrent)->check(CLI::Range(1, 1024));
  app.add_option("--exploration", settings.search.exploration);
  app.add_option("--promotions", settings.search.promotions);
  app.add_option("--evaluations", settings.search.evaluations, "rollouts");
  CLI11_PARSE(app, argc, argv);

  const Task task = MakeTask("cartpole");
  settings.search.bound = task.parameter_bound;
  settings.search.first_sigma = task.search_first_sigma;
  settings.search.restart_sigma = task.search_restart_sigma;
  settings.search.restart_decades = task.search_restart_decades;
  const Dataset data = ReadDataset(task, {&settings.run, 1}, settings.episodes);
  const auto fits = FitHyperparameters(data, {}, {}, kSeed, kEpisode, settings.threads);
  std::vector<ExactGp> gps;
  for (int e = 0; e < data.n_outputs(); ++e) {
    gps.emplace_back(data.inputs, data.targets.col(e), fits[e].hyperparameters);
  }
  const auto policy = MakePolicy(task, PolicyOptions{});
  const std::vector<double> origin(policy->n_parameters(), 0.0);
  std::printf("%s: %d points; P = %d, lambda = %d, %d instances\n", settings.run.c_str(),
              data.n_points(), policy->n_parameters(), settings.search.population,
              settings.search.concurrent);
  for (const bool exact : {false, true}) {
    QueryPlanOptions options;
    if (exact) options.variance_tolerance = options.mean_tolerance = 0;
    PlannedModel model(gps, options, settings.threads);
    Evaluator evaluator(task, *policy, model.exact_factors(), {.threads = settings.threads});
    const Eigen::MatrixXd met =
        ProbeInputs(settings.search, origin, kSeed, kEpisode, task.n_inputs(), &evaluator);
    Eigen::MatrixXd probes(data.inputs.rows() + met.rows(), met.cols());
    probes << data.inputs, met;
    model.Choose(std::move(probes));
    PrintPlan(exact ? "exact fp64" : "default plan", model);
    Compare(task, *policy, model, settings);
    std::fflush(stdout);
  }
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("generation_bench", downpour::Main, argc, argv);
}
