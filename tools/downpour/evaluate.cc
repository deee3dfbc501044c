// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <numeric>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/learner/execute.h"
#include "engine/learner/run_directory.h"
#include "engine/learner/saved_policy.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/config.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/robot.h"
#include "tools/downpour/stop.h"

namespace downpour {
namespace {

struct EvaluateArguments {
  std::string run;
  int episode = 0;  // 0: the last policy
  int starts = 100;
  double start_std = 0.01;
  std::uint64_t seed = 0;
  std::string robot;  // --system
  bool json = false;
};

std::vector<Field> EvaluateFields(EvaluateArguments& arguments) {
  return {
      EpisodeField(&arguments.episode, "Policy of this episode; 0: the last one learnt."),
      {.key = "starts",
       .option = "--starts",
       .target = &arguments.starts,
       .min = 1,
       .max = 1e6,
       .description = "Number of starts; with --system 1 if left out."},
      {.key = "start_std",
       .option = "--start-std",
       .target = &arguments.start_std,
       .min = 0,
       .max = 1000,
       .description = "Standard deviation of every start variable, in its own unit."},
      {.key = "seed",
       .option = "--seed",
       .target = &arguments.seed,
       .min = 0,
       .max = kMaxSeed,
       .description = "Seed of the starts and the noise."},
      {.key = "system",
       .option = "--system",
       .target = &arguments.robot,
       .description = "\"exec:PROGRAM ARGS\": run on the robot that the program drives "
                      "(docs/robot.md)."},
  };
}

struct Evaluation {
  std::vector<double> returns;  // (starts) sorted
  int n_solved = 0;
  int n_diverged = 0;   // starts whose simulation broke: return 0, not solved
  std::string failure;  // of the robot, which ended the evaluation; "": none
};

// Quantile of sorted values, linear between neighbours (NumPy's default).
double Quantile(const std::vector<double>& sorted, double share) {
  const double position = share * static_cast<double>(sorted.size() - 1);
  const std::size_t below = static_cast<std::size_t>(position);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (position - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

double Mean(const std::vector<double>& x) {
  return std::accumulate(x.begin(), x.end(), 0.0) / static_cast<double>(x.size());
}

Evaluation RunStarts(Task task, const SavedPolicy& saved, const EvaluateArguments& arguments) {
  task.start_std.assign(task.start_std.size(), arguments.start_std);
  const std::unique_ptr<Policy> policy = MakePolicy(saved, task);
  const std::unique_ptr<System> system = task.make_system();
  const auto controller = [&](int step, std::span<const double> features,
                              std::span<double> action) {
    policy->Act(step, saved.parameters, features, action);
  };
  Evaluation evaluation;
  for (int i = 0; i < arguments.starts; ++i) {
    const auto start = static_cast<std::uint32_t>(i);
    Execution execution;
    try {
      execution = ExecuteEpisode(
          task, *system, i + 1, DeriveKey(arguments.seed, StreamPurpose::kEvaluate, {start, 0}),
          DeriveKey(arguments.seed, StreamPurpose::kEvaluate, {start, 1}), controller);
    } catch (const InvalidInput&) {  // a number that is not finite
      ++evaluation.n_diverged;
    } catch (const SystemFailure& failure) {
      execution.outcome = fmt::format("{} before its first step: {}", kAborted, failure.what());
    }
    if (execution.outcome.starts_with(kAborted)) {
      evaluation.failure =
          fmt::format("start {} of {} {}", i + 1, arguments.starts, execution.outcome);
      break;
    }
    evaluation.returns.push_back(execution.real_return);
    evaluation.n_solved += execution.solved ? 1 : 0;
  }
  std::sort(evaluation.returns.begin(), evaluation.returns.end());
  return evaluation;
}

void Print(const EvaluateArguments& arguments, const SavedPolicy& saved, const Evaluation& result) {
  const std::vector<double>& returns = result.returns;
  const std::size_t n_starts = returns.size();
  const double share = result.n_solved / static_cast<double>(n_starts);
  if (arguments.json) {
    nlohmann::ordered_json line;
    line["run"] = arguments.run;
    line["task"] = saved.task;
    line["episode"] = saved.episode;
    line["starts"] = n_starts;
    line["start_std"] = arguments.start_std;
    line["seed"] = arguments.seed;
    line["mean"] = Mean(returns);
    line["minimum"] = returns.front();
    line["quartile_1"] = Quantile(returns, 0.25);
    line["median"] = Quantile(returns, 0.5);
    line["quartile_3"] = Quantile(returns, 0.75);
    line["maximum"] = returns.back();
    line["solved_share"] = share;
    line["diverged"] = result.n_diverged;
    // A path need not be UTF-8.
    fmt::print("{}\n", line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    return;
  }
  fmt::print("{}, policy of episode {}, {} starts with std {} (seed {})\n", saved.task,
             saved.episode, n_starts, arguments.start_std, arguments.seed);
  fmt::print("return   mean {:.2f}   quartiles {:.2f}  {:.2f}  {:.2f}   range {:.2f} to {:.2f}\n",
             Mean(returns), Quantile(returns, 0.25), Quantile(returns, 0.5),
             Quantile(returns, 0.75), returns.front(), returns.back());
  fmt::print("solved   {} of {} ({:.0f} %)\n", result.n_solved, n_starts, 100 * share);
  if (result.n_diverged == 0) return;
  fmt::print("diverged {} of {}, each counted as a return of 0 and not solved\n", result.n_diverged,
             n_starts);
}

void Evaluate(const EvaluateArguments& arguments) {
  const RunDirectory directory = RunDirectory::Open(arguments.run);
  const std::filesystem::path path = directory.path();
  ResolvedRun run = ResolveConfig(ReadConfigFile((path / "config.toml").string()));
  // A robot moves only for those who ask for it, whatever the run was learnt on.
  run.config.system.program = arguments.robot;
  UseRobot(run.config, &run.task);
  const std::filesystem::path file =
      path / (arguments.episode == 0 ? std::string("policy.json")
                                     : fmt::format("policy_{}.json", arguments.episode));
  if (!std::filesystem::exists(file)) {
    throw InvalidInput(fmt::format("{}: no such policy; {}", file.string(),
                                   arguments.episode == 0
                                       ? "the run must have learnt from one episode at least"
                                       : "--episode must be a learnt episode of the run"));
  }
  const SavedPolicy saved = ReadPolicy(file);
  Evaluation evaluation;
  try {
    evaluation = RunStarts(run.task, saved, arguments);
  } catch (const Interrupted&) {
    throw RunInterrupted("interrupted", StopSignal());
  }
  if (!evaluation.returns.empty()) Print(arguments, saved, evaluation);
  if (StopRequested()) throw RunInterrupted(evaluation.failure, StopSignal());
  if (!evaluation.failure.empty()) throw SystemFailure(evaluation.failure);
}

}  // namespace

void AddEvaluateCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand(
      "evaluate",
      "Run the last policy of a run, or that of --episode, on the simulator from many noisy "
      "starts, or on a robot");
  auto arguments = std::make_shared<EvaluateArguments>();
  auto settings = std::make_shared<std::vector<Setting>>();
  command->add_option("RUN", arguments->run, "Run directory")->required()->check(NotEmpty());
  for (const Field& field : EvaluateFields(*arguments)) {
    const auto read = [settings, field](const std::string& text) {
      settings->push_back(ReadSetting(field.option, field, text));
    };
    command
        ->add_option_function<std::string>(field.option, read,
                                           WithDefault(field.description, field))
        ->type_name(field.max > field.min ? "N" : "PATH");
  }
  command->add_flag("--json", arguments->json, "One JSON object on standard output");
  command->callback([arguments, settings] {
    ApplySettings(EvaluateFields(*arguments), *settings);
    const bool counted = std::any_of(settings->begin(), settings->end(),
                                     [](const Setting& s) { return s.key == "starts"; });
    if (!arguments->robot.empty() && !counted) arguments->starts = 1;
    Evaluate(*arguments);
  });
}

}  // namespace downpour
