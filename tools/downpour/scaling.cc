// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <omp.h>
#include <unistd.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/rollout_objective.h"
#include "engine/learner/suggest.h"
#include "engine/rollout/tiling.h"
#include "engine/search/search_options.h"
#include "tasks/registry.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/profile_model.h"
#include "tools/downpour/python_script.h"
#include "tools/downpour/scaling_output.h"
#include "tools/measure/ceilings.h"
#include "tools/measure/machine.h"
#include "tools/measure/rollout_profile.h"

namespace downpour {

extern const char* const k_performance_plot_py;  // performance_plot.py

namespace {

// Rollouts an episode of the learning that makes the models: enough to solve the tasks mostly.
constexpr std::int64_t kLearningEvaluations = 20000;

struct ScalingArguments {
  std::vector<std::string> tasks = {"pendulum", "cartpole"};
  std::vector<int> threads;  // empty: 1 to all processors
  std::vector<std::string> outputs;
  std::string csv;
  int episodes = 4, replicates = 5, expect = 16;
  int concurrent = PolicySearchOptions{}.concurrent;
  std::int64_t evaluations = 60000;
  bool weak = true, pin = false, json = false;
};

std::vector<Field> ScalingFields(ScalingArguments& arguments) {
  return {{.key = "threads",
           .option = "--threads",
           .target = &arguments.threads,
           .min = 1,
           .max = 1024,
           .description = "Numbers of threads, a list; 1 to the number of processors if left out."},
          {.key = "replicates",
           .option = "--replicates",
           .target = &arguments.replicates,
           .min = 1,
           .max = 1000,
           .description = "Searches for each number of threads, each with a seed of its own."},
          {.key = "evaluations",
           .option = "--evaluations",
           .target = &arguments.evaluations,
           .min = 100,
           .max = 1e9,
           .description = "Rollouts of a search."},
          {.key = "concurrent",
           .option = "--concurrent",
           .target = &arguments.concurrent,
           .min = 1,
           .max = 1024,
           .description = "search.concurrent of learn: CMA-ES instances side by side."},
          {.key = "episodes",
           .option = "--episodes",
           .target = &arguments.episodes,
           .min = 2,
           .max = 100,
           .description = "The search is that before this episode of a fresh run."},
          {.key = "expect",
           .option = "--expect",
           .target = &arguments.expect,
           .min = 1,
           .max = 1024,
           .description = "Expected speed-ups up to this number of threads."}};
}

// Bound threads are told by the environment before OpenMP starts: this program starts again.
void PinThreads() {
  if (std::getenv("OMP_PROC_BIND") != nullptr) return;
  setenv("OMP_PROC_BIND", "close", 1);
  setenv("OMP_PLACES", "cores", 0);
  std::ifstream file("/proc/self/cmdline");
  std::vector<std::string> words;
  for (std::string word; std::getline(file, word, '\0');) words.push_back(word);
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  execv("/proc/self/exe", argv.data());
  throw FileError("--pin: cannot start again with OMP_PROC_BIND");
}

// The options of a search as `downpour learn` has them for the task.
LearnerOptions DefaultOptions(const std::string& task, int episodes) {
  const Setting name{"TASK", "task", task, task};
  LearnerOptions options = ResolveConfig({name}).config.learner;
  options.episodes = episodes;
  return options;
}

// A task, the model of its last episode and what came before.
struct Subject {
  Task task;
  LearnerOptions options;
  ProfileModel model;
  std::vector<double> start;  // of the search: the policy of the episode before
};

Subject MakeSubject(const std::string& name, const ScalingArguments& arguments, int threads) {
  Subject subject{MakeTask(name), DefaultOptions(name, arguments.episodes), {}, {}};
  LearnerOptions learning = subject.options;
  learning.threads = threads;
  learning.search.evaluations = kLearningEvaluations;
  Learner learner(subject.task, learning);
  while (!learner.done()) learner.RunEpisode({});
  const std::vector<EpisodeRecord>& records = learner.state().episodes;
  subject.start = records[records.size() - 2].policy;
  AdaptToStart(!subject.start.empty(), &subject.options.search);
  if (subject.start.empty()) subject.start.assign(learner.policy().n_parameters(), 0.0);
  subject.options.search.evaluations = arguments.evaluations;
  subject.options.search.concurrent = arguments.concurrent;
  subject.model = LearntModel(subject.task, subject.options, learner.state(), records.back(),
                              MakePolicy(subject.task, subject.options.policy), {});
  subject.model.task = nullptr;  // the subject is moved
  return subject;
}

struct SearchOutcome {
  TimedSearch times;
  std::vector<double> parameters;
  std::vector<GenerationLanes> generations;  // where one thread searched
};

// By the default settings, candidates of one run, and only they, meet the same random numbers.
int CountRuns(const CandidateBatch& batch) {
  int runs = 1;
  for (std::size_t c = 1; c < batch.keys.size(); ++c) runs += !(batch.keys[c] == batch.keys[c - 1]);
  return runs;
}

SearchOutcome Search(const Subject& subject, TimedSearch what) {
  PolicySearchOptions options = subject.options.search;
  options.threads = what.threads;
  if (what.weak) {
    options.evaluations *= what.threads;
    options.concurrent *= what.threads;
  }
  EvaluatorOptions rollout = subject.model.rollout;
  rollout.threads = what.threads;
  RolloutObjective objective(subject.task, *subject.model.policy, subject.model.factors, rollout,
                             subject.model.prior);
  SearchOutcome outcome{what, {}, {}};
  double waiting_seconds = 0;
  const auto start = std::chrono::steady_clock::now();
  const PolicySearchResult result = SearchPolicy(
      options, subject.start, static_cast<std::uint64_t>(what.replicate), subject.model.episode,
      [&](const CandidateBatch& batch, std::span<double> returns) {
        objective.Evaluate(batch, returns);
        outcome.generations.push_back({CountRuns(batch), static_cast<int>(returns.size())});
      },
      [&](const PolicySearchProgress& now) { waiting_seconds = now.waiting_seconds; }, nullptr,
      objective.own_objectives());
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
  const EvaluatorStatistics statistics = objective.Statistics(waiting_seconds);
  outcome.times.seconds = elapsed.count();
  outcome.times.rollout_seconds = statistics.seconds;
  outcome.times.lane_fill = statistics.LaneFill();
  outcome.times.idle_share = std::max(0.0, statistics.IdleShare(what.threads));
  outcome.times.evaluations = result.evaluations;
  outcome.parameters = result.parameters;
  return outcome;
}

// Median of rollout_seconds, or of the time outside, of the strong searches by `threads`.
double MedianSeconds(const ScaledTask& task, int threads, bool outside) {
  std::vector<double> values;
  for (const TimedSearch& s : task.searches) {
    if (s.weak || s.threads != threads) continue;
    values.push_back(outside ? s.seconds - s.rollout_seconds : s.seconds);
  }
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

// What the expected curve needs; ceilings for up to as many threads as there are processors.
ScalingBasis MeasureBasis(const Subject& subject, const ScaledTask& task,
                          const std::vector<int>& threads,
                          std::vector<GenerationLanes> generations) {
  const int processors = omp_get_num_procs();
  ScalingBasis basis{.generations = std::move(generations),
                     .tile_unit = TileUnit(subject.model.factors)};
  basis.seconds = MedianSeconds(task, 1, false);
  int most = 1;
  for (const int t : threads) most = t <= processors ? std::max(most, t) : most;
  basis.serial_seconds =
      SerialSeconds(MedianSeconds(task, 1, true), MedianSeconds(task, most, true), most);
  const std::size_t bytes = PackedBytes(subject.model.factors);
  const MemoryLevel level = LevelOf(bytes, ReadCacheSizes(), 1);
  basis.shared_memory = level != kLevel2;
  double one = 0;
  for (int t = 1; t <= processors; ++t) {
    const double peak = FmaPeakTogether(t);
    if (t == 1) one = peak;
    basis.fma_gain.push_back(peak / one);
    basis.gigabytes_per_second.push_back(ReadBandwidthTogether(t, std::max<std::size_t>(bytes, 1)));
  }
  const double bytes_a_query = QueryWork(subject.model.factors, true, kTileLanes).bytes;
  const double queries = static_cast<double>(task.searches.front().evaluations) *
                         subject.task.horizon * subject.task.n_states();
  basis.demand = 1e-9 * bytes_a_query * queries / (basis.seconds - MedianSeconds(task, 1, true));
  return basis;
}

ScaledTask ScaleTask(const std::string& name, const ScalingArguments& arguments) {
  const Subject subject = MakeSubject(name, arguments, omp_get_num_procs());
  ScaledTask task{.task = name, .points = subject.model.points, .plans = subject.model.plans};
  std::vector<GenerationLanes> generations;
  for (int replicate = 0; replicate < arguments.replicates; ++replicate) {
    std::vector<double> parameters;
    for (const int threads : arguments.threads) {
      SearchOutcome outcome = Search(subject, {false, threads, replicate});
      if (parameters.empty()) parameters = outcome.parameters;
      if (parameters != outcome.parameters) {
        throw std::logic_error("the number of threads changed the result of the search");
      }
      task.searches.push_back(outcome.times);
      if (threads == 1) generations = std::move(outcome.generations);
      if (!arguments.weak || threads == 1) continue;
      task.searches.push_back(Search(subject, {true, threads, replicate}).times);
    }
  }
  const ScalingBasis basis = MeasureBasis(subject, task, arguments.threads, std::move(generations));
  task.serial_share = basis.serial_seconds / basis.seconds;
  const int last = std::max(arguments.expect, arguments.threads.back());
  for (int t = 1; t <= last; ++t) task.expected.push_back(ExpectSpeedUp(basis, t));
  return task;
}

void Prepare(ScalingArguments* arguments) {
  const std::vector<std::string> names = TaskNames();
  for (const std::string& task : arguments->tasks) {
    if (std::find(names.begin(), names.end(), task) != names.end()) continue;
    throw InvalidInput(fmt::format("TASK = {}: {}", task, Suggest(task, names)));
  }
  CheckPictureNames(arguments->outputs);
  std::vector<int>& threads = arguments->threads;
  if (threads.empty()) {
    for (int t = 1; t <= omp_get_num_procs(); ++t) threads.push_back(t);
  }
  threads.push_back(1);  // what speed-ups are against
  std::sort(threads.begin(), threads.end());
  threads.erase(std::unique(threads.begin(), threads.end()), threads.end());
}

void Scale(ScalingArguments arguments) {
  Prepare(&arguments);
  if (arguments.pin) PinThreads();
  ScalingReport report{.pinned = omp_get_proc_bind() != omp_proc_bind_false,
                       .replicates = arguments.replicates,
                       .load_average = LoadAverage()};
  const std::string warning = LoadWarning();
  if (!warning.empty()) fmt::print(stderr, "downpour: warning: {}\n", warning);
  for (const std::string& task : arguments.tasks) {
    report.tasks.push_back(ScaleTask(task, arguments));
  }
  const std::string json = ScalingJson(report).dump(2);
  if (arguments.json) {
    fmt::print("{}\n", json);
  } else {
    PrintScaling(report);
  }
  if (!arguments.csv.empty()) WriteFileAtomically(arguments.csv, ScalingCsv(report));
  if (arguments.outputs.empty()) return;
  std::vector<std::string> words = {"scaling"};
  words.insert(words.end(), arguments.outputs.begin(), arguments.outputs.end());
  RunPythonScript(k_performance_plot_py, std::move(words), json);
}

}  // namespace

void AddScalingCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand(
      "scaling", "Time policy searches by 1, 2, ... threads: speed-up and what holds it back");
  auto arguments = std::make_shared<ScalingArguments>();
  command->add_option("TASK", arguments->tasks, "Tasks (default pendulum and cartpole)");
  command
      ->add_option("-o,--output", arguments->outputs,
                   "Picture of speed-up and efficiency, .png or .svg; repeatable")
      ->type_name("FILE")
      ->allow_extra_args(false)
      ->check(NotEmpty());
  command->add_option("--csv", arguments->csv, "Table of every search")
      ->type_name("FILE")
      ->check(NotEmpty());
  command->add_flag("--json", arguments->json, "Print JSON in place of tables");
  command->add_flag("--pin", arguments->pin,
                    "Bind threads to cores one after the other (OMP_PROC_BIND=close "
                    "OMP_PLACES=cores, unless they are set)");
  command->add_flag("!--no-weak", arguments->weak,
                    "Leave out the searches that grow with the threads");
  RunWithFields(command, arguments, ScalingFields, Scale);
  command->footer(
      "A search is one episode's on a fixed model; all numbers of threads take turns, and must "
      "end\n"
      "with the same bits. \"weak\" gives each thread a search of its own size: the efficiency is\n"
      "that of the larger search in the same time. \"expect\" is computed from the measured "
      "serial\n"
      "share, the runs and tiles of a generation, and FMA peak and bandwidth of as many threads.");
}

}  // namespace downpour
