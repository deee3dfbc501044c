// SPDX-License-Identifier: Apache-2.0
// One episode's search as the paper counts it: 400,000 rollouts x 40 steps x 4 outputs = 64 million
// GP queries on a cart-pole model of 8 episodes (n = 320), by the exact posteriors in fp64 and by
// the default plan. The search is the learner's own, so that candidates, batches, plan checks and
// the work between batches are those of a run. Prints where the time went: 60 of the search's
// batches, evenly over it, are run again with a clock between the kernels (rollout_parts.h);
// their shares of the evaluator's time on the same batches divide its time in the search.
//   paper_episode [RUN] [--threads N] [--plan default|exact|both]
// RUN is a run directory of cart-pole. Without it, the first call learns 8 episodes with default
// settings and seed 0 and keeps their transitions in runs/paper_episode.
#include <omp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <numeric>
#include <span>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "bench/program.h"
#include "bench/run_data.h"
#include "engine/errors.h"
#include "engine/gp/gp_model.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/csv_tables.h"
#include "engine/learner/learner.h"
#include "engine/learner/plan_probes.h"
#include "engine/learner/planned_model.h"
#include "engine/learner/rollout_objective.h"
#include "engine/rollout/evaluator.h"
#include "engine/search/policy_search.h"
#include "kernels/fma_peak/fma_peak.h"
#include "tasks/registry.h"
#include "tools/measure/ceilings.h"
#include "tools/measure/kept_batch.h"
#include "tools/measure/machine.h"

namespace downpour {
namespace {

constexpr int kEpisodes = 8;
constexpr std::uint64_t kSeed = 0;
constexpr int kPlanChecks = 20;  // over a search, as in the learner
constexpr int kSample = 60;      // batches whose parts are timed
constexpr int kRepetitions = 3;

using Clock = std::chrono::steady_clock;

double SecondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

PolicySearchOptions SearchOptions(const Task& task, std::int64_t evaluations, int threads) {
  PolicySearchOptions options;
  options.evaluations = evaluations;
  options.bound = task.parameter_bound;
  options.first_sigma = task.search_first_sigma;
  options.restart_sigma = task.search_restart_sigma;
  options.restart_decades = task.search_restart_decades;
  options.threads = threads;
  return options;
}

// Learns kEpisodes with default settings and writes their transitions into `run`.
void MakeRun(const Task& task, const std::filesystem::path& run, int threads) {
  LearnerOptions options;
  options.episodes = kEpisodes;
  options.seed = kSeed;
  options.threads = threads;
  options.search = SearchOptions(task, options.search.evaluations, threads);
  Learner learner(task, options);
  while (!learner.done()) {
    const EpisodeRecord& record = learner.RunEpisode({});
    std::fprintf(stderr, "making %s: episode %d of %d, return %.2f\n", run.c_str(), record.episode,
                 kEpisodes, record.real_return);
  }
  std::filesystem::create_directories(run);
  WriteFileAtomically(run / "transitions.csv", TransitionsCsv(task, learner.state()));
}

using PartSeconds = std::array<double, kRolloutParts>;

// What is measured around a search.
struct Episode {
  double plan_seconds = 0, search_seconds = 0, check_seconds = 0;
  EvaluatorStatistics statistics;
  int plan_changes = 0;
  double predicted_return = 0;
  std::vector<KeptBatch> sample;  // of the search's batches, evenly over its rollouts
};

// Plans the queries of `model` and searches, as the learner does for its next episode.
Episode Search(const Task& task, const Policy& policy, const Dataset& data,
               PolicySearchOptions options, PlannedModel* model) {
  options.relaxed_exploration = false;  // as for every search but the first
  Episode episode;
  Clock::time_point start = Clock::now();
  const std::vector<double> origin(policy.n_parameters(), 0.0);
  const EvaluatorOptions rollout{.threads = options.threads};
  Evaluator exact(task, policy, model->exact_factors(), rollout);
  const Eigen::MatrixXd met =
      ProbeInputs(options, origin, kSeed, kEpisodes + 1, task.n_inputs(), &exact);
  Eigen::MatrixXd probes(data.inputs.rows() + met.rows(), met.cols());
  probes << data.inputs, met;
  model->Choose(std::move(probes));
  episode.plan_seconds = SecondsSince(start);

  RolloutObjective objective(task, policy, model->factors(), rollout);
  std::int64_t next_check = 0;
  const auto check = [&](const PolicySearchProgress& now) {
    const Clock::time_point check_start = Clock::now();
    const int changed = model->Check(NextInputs(now.runs, task.n_inputs(), objective.evaluator()));
    if (changed > 0) objective.SetFactors(model->factors());
    episode.plan_changes += changed;
    next_check = now.evaluations + options.evaluations / kPlanChecks + 1;
    episode.check_seconds += SecondsSince(check_start);
  };
  start = Clock::now();
  const PolicySearchResult result = SearchPolicy(
      options, origin, kSeed, kEpisodes + 1,
      [&](const CandidateBatch& batch, std::span<double> returns) {
        objective.Evaluate(batch, returns);
      },
      [&](const PolicySearchProgress& now) {
        episode.statistics = objective.Statistics(now.waiting_seconds);
        if (now.runs.empty()) return;
        if (now.evaluations >= next_check) check(now);
        if (now.evaluations * kSample >= options.evaluations * std::ssize(episode.sample)) {
          episode.sample.emplace_back(NextGeneration(now.runs).Candidates());
        }
      },
      nullptr, objective.own_objectives());
  episode.search_seconds = SecondsSince(start);
  episode.predicted_return = result.predicted_return;
  return episode;
}

// A batch of the sample in seconds: the best of some repetitions.
struct BatchTimes {
  double one_thread = std::numeric_limits<double>::infinity();
  double all_threads = std::numeric_limits<double>::infinity();
  double parts_sum = std::numeric_limits<double>::infinity();
  PartSeconds parts = {};  // of the repetition with the least sum
};

// Means over the batches of the sample, in seconds a rollout.
struct SampleTimes {
  double one_thread = 0, all_threads = 0;
  PartSeconds parts = {};
  double peak_one = 0, peak_all = 0;  // GFLOP/s between the repetitions, best
};

SampleTimes TimeSample(const Task& task, const Policy& policy, std::span<const KeptBatch> sample,
                       const PlannedModel& model, int threads) {
  const std::span<const QueryFactor> factors = model.factors();
  Evaluator one(task, policy, factors, {.threads = 1}),
      all(task, policy, factors, {.threads = threads}),
      timed(task, policy, factors, {.threads = threads});
  timed.TimeParts();
  SampleTimes times;
  std::vector<BatchTimes> best(sample.size());
  std::vector<double> returns, again;
  for (int repetition = 0; repetition < kRepetitions; ++repetition) {
    times.peak_one = std::max(times.peak_one, FmaPeakTogether(1));
    times.peak_all = std::max(times.peak_all, FmaPeakTogether(threads));
    for (std::size_t i = 0; i < sample.size(); ++i) {
      const KeptBatch& batch = sample[i];
      returns.resize(batch.TotalRollouts());
      again.resize(returns.size());
      const auto time = [&](Evaluator* evaluator, double* seconds) {
        const Clock::time_point start = Clock::now();
        evaluator->Evaluate(batch.parameters, batch.keys, batch.n_rollouts, batch.first_rollout,
                            returns);
        *seconds = std::min(*seconds, SecondsSince(start));
      };
      time(&one, &best[i].one_thread);
      time(&all, &best[i].all_threads);
      const EvaluatorStatistics before = timed.statistics();
      timed.Evaluate(batch.parameters, batch.keys, batch.n_rollouts, batch.first_rollout, again);
      const PartSeconds parts = timed.statistics().Since(before).parts.seconds;
      if (again != returns) throw std::runtime_error("the clock changed the rollouts");
      const double sum = std::accumulate(parts.begin(), parts.end(), 0.0);
      if (sum < best[i].parts_sum) best[i].parts = parts;
      best[i].parts_sum = std::min(best[i].parts_sum, sum);
    }
  }
  for (std::size_t i = 0; i < sample.size(); ++i) {
    const double share = 1.0 / (static_cast<double>(sample.size()) * sample[i].TotalRollouts());
    times.one_thread += share * best[i].one_thread;
    times.all_threads += share * best[i].all_threads;
    for (int part = 0; part < kRolloutParts; ++part) {
      times.parts[part] += share * best[i].parts[part];
    }
  }
  return times;
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

void PrintPart(const char* name, double seconds, double search_seconds) {
  std::printf("  %-44s %8.3f s %6.1f %%\n", name, seconds, 100 * seconds / search_seconds);
}

void Print(const Episode& episode, const SampleTimes& times, int threads) {
  static constexpr const char* kNames[] = {
      "packing of tiles",  "policy",     "GP queries", "prior",
      "sampling (Philox)", "transition", "features",   "reward"};
  static_assert(std::size(kNames) == kRolloutParts);
  const EvaluatorStatistics& s = episode.statistics;
  const auto queries = static_cast<double>(s.gp_queries);
  std::printf(
      "%.3f s for %lld rollouts, %.2f million GP queries: %.1f ns a query, %.2f million/s\n",
      episode.search_seconds, static_cast<long long>(s.rollouts), queries * 1e-6,
      1e9 * episode.search_seconds / queries, 1e-6 * queries / episode.search_seconds);
  std::printf("lane fill %.3f, %lld diverged, plans changed %d times, predicted return %.2f\n",
              static_cast<double>(s.steps) / static_cast<double>(s.lane_steps),
              static_cast<long long>(s.diverged), episode.plan_changes, episode.predicted_return);
  double rest = s.seconds;
  for (int part = 0; part < kRolloutParts; ++part) {
    const double share = times.parts[part] / (threads * times.all_threads);
    rest -= share * s.seconds;
    PrintPart(kNames[part], share * s.seconds, episode.search_seconds);
  }
  PrintPart("idle threads, rest of the rollouts", rest, episode.search_seconds);
  PrintPart("checks of the plan", episode.check_seconds, episode.search_seconds);
  PrintPart("search between batches", episode.search_seconds - s.seconds - episode.check_seconds,
            episode.search_seconds);
  std::printf("before it: plan chosen in %.2f s\n", episode.plan_seconds);
  std::printf("FMA peak of one thread: %.1f GFLOP/s fp64\n", times.peak_one);
  if (threads == 1) return;
  std::printf(
      "%d threads: rollouts %.2f x as fast as by one thread (%d batches of the search), "
      "FMA peak %.1f GFLOP/s, %.2f x\n",
      threads, times.one_thread / times.all_threads, kSample, times.peak_all,
      times.peak_all / times.peak_one);
}

int Main(int argc, char** argv) {
  std::filesystem::path run;
  std::string plan = "both";
  std::int64_t evaluations = 400000;
  int threads = 2;
  CLI::App app("64 million GP queries of an episode's search, and where their time goes");
  app.add_option("run", run, "run directory of cart-pole; made if it is not given");
  app.add_option("--threads", threads)->check(CLI::Range(1, 1024));
  app.add_option("--plan", plan)->check(CLI::IsMember({"both", "default", "exact"}));
  app.add_option("--evaluations", evaluations, "rollouts");
  CLI11_PARSE(app, argc, argv);

  const Task task = MakeTask("cartpole");
  if (run.empty()) {
    run = "runs/paper_episode";
    if (!std::filesystem::exists(run / "transitions.csv")) MakeRun(task, run, threads);
  }
  const Dataset data = ReadDataset(task, {&run, 1}, kEpisodes);
  if (data.n_points() != kEpisodes * task.horizon) {
    throw InvalidInput(run.string() + ": " + std::to_string(data.n_points()) +
                       " transitions: must be " + std::to_string(kEpisodes * task.horizon) + ", " +
                       std::to_string(kEpisodes) + " episodes");
  }
  const Clock::time_point start = Clock::now();
  std::vector<ExactGp> gps;
  const auto fits = FitHyperparameters(data, {}, {}, kSeed, kEpisodes + 1, threads);
  for (int e = 0; e < data.n_outputs(); ++e) {
    gps.emplace_back(data.inputs, data.targets.col(e), fits[e].hyperparameters);
  }
  const double model_seconds = SecondsSince(start);
  std::printf("%s, %d processors, %s; %d thread%s\n", CpuModel().c_str(), omp_get_num_procs(),
              SimdTargetName(), threads, threads == 1 ? "" : "s");
  std::printf("%s: %d points, model learnt from scratch in %.2f s\n", run.c_str(), data.n_points(),
              model_seconds);
  const auto policy = MakePolicy(task, PolicyOptions{});
  for (const char* name : {"default", "exact"}) {
    if (plan != "both" && plan != name) continue;
    QueryPlanOptions options;
    if (name == std::string("exact")) options = {.variance_tolerance = 0, .mean_tolerance = 0};
    PlannedModel model(gps, options, threads);
    const Episode episode =
        Search(task, *policy, data, SearchOptions(task, evaluations, threads), &model);
    const SampleTimes times = TimeSample(task, *policy, episode.sample, model, threads);
    PrintPlan(name == std::string("exact") ? "exact fp64" : "default plan", model);
    Print(episode, times, threads);
    std::fflush(stdout);
  }
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("paper_episode", downpour::Main, argc, argv);
}
