// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/platform.h"
#include "engine/learner/run_directory.h"
#include "tasks/toml_task/task_copy.h"
#include "tasks/toml_task/toml_task.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/config.h"
#include "tools/downpour/mpi_world.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/prior.h"
#include "tools/downpour/progress.h"
#include "tools/downpour/robot.h"
#include "tools/downpour/shared_rollouts.h"
#include "tools/downpour/shell.h"
#include "tools/downpour/stop.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

// One option of the table of fields, as given.
struct OptionValue {
  CLI::Option* option = nullptr;
  std::string text;
  bool flag = false;
};

// The command line as given.
struct LearnArguments {
  std::string program;  // as typed
  std::string task;
  std::string config_file;
  std::string resume;
  std::vector<std::string> assignments;        // --set
  std::map<std::string, OptionValue> options;  // by the field's key
};

// What a run needs, whether new or resumed.
struct OpenRun {
  RunConfig config;
  RunDirectory directory;
  Learner learner;
};

// Settings in the order in which they override: --set, then the options.
std::vector<Setting> CommandLineSettings(const LearnArguments& arguments) {
  std::vector<Setting> settings;
  for (const std::string& text : arguments.assignments) {
    settings.push_back(ParseAssignment("--set", text));
  }
  RunConfig defaults;
  for (const Field& field : ConfigFields(defaults)) {
    if (field.key == "task" && !arguments.task.empty()) {
      settings.push_back(ReadSetting("TASK", field, arguments.task));
    }
    if (field.option.empty()) continue;
    const OptionValue& value = arguments.options.at(field.key);
    if (bool* const* target = std::get_if<bool*>(&field.target)) {
      const char* turned = **target ? "false" : "true";
      if (value.flag) settings.push_back(ReadSetting(field.option, field, turned));
    } else if (value.option->count() > 0) {
      settings.push_back(ReadSetting(field.option, field, value.text));
    }
  }
  return settings;
}

// runs/TASK-seedSEED, or with -2, -3, ... behind it if that is there.
fs::path DefaultDirectory(const std::string& task, const RunConfig& config) {
  const std::string base = fmt::format("runs/{}-seed{}", task, config.learner.seed);
  fs::path path = base;
  for (int i = 2; fs::exists(path); ++i) path = fmt::format("{}-{}", base, i);
  return path;
}

// config.toml of the run at `path`: its copy of a task's file is named from there.
std::string SavedConfig(RunConfig config, const fs::path& path) {
  if (IsTaskFile(config.task)) {
    config.task =
        fs::path(config.task).lexically_normal().lexically_relative(path.lexically_normal());
  }
  return WriteConfig(config);
}

// A run goes on with its own copy of the task's file. One who has changed the original since would
// expect something else.
void CheckTaskFile(const RunConfig& config, const std::string& given, const fs::path& run) {
  if (!IsTaskFile(config.task)) return;
  const fs::path folder = (run / kTaskFolder).lexically_normal();
  const fs::path path = fs::path(config.task).lexically_relative(folder);
  for (const std::string& source : {given, config.task_source}) {
    if (source.empty()) continue;
    const std::string changed = ChangedSince(config.task, path, fs::absolute(source));
    if (changed.empty()) continue;
    throw InvalidInput(
        fmt::format("{}: differs from the copy that the run began with, in {}; must be as it was "
                    "then, or begin a new run",
                    changed, folder.string()));
  }
}

// `shared`: by several processes.
OpenRun NewRun(const LearnArguments& arguments, bool shared) {
  std::vector<Setting> settings;
  if (!arguments.config_file.empty()) settings = ReadConfigFile(arguments.config_file);
  for (Setting& setting : CommandLineSettings(arguments)) settings.push_back(std::move(setting));
  ResolvedRun run = ResolveConfig(settings);
  if (shared) CheckShareable(run.config);
  UseRobot(run.config, &run.task);
  UsePrior(run.config, &run.task);
  // The learner checks task and options before anything is written.
  Learner learner(run.task, run.config.learner);
  const fs::path path = run.config.output_directory.empty()
                            ? DefaultDirectory(run.task.name, run.config)
                            : fs::path(run.config.output_directory);
  std::vector<FileCopy> task_files;
  if (IsTaskFile(run.config.task)) {
    task_files = CopyTask(run.config.task);
    run.config.task_source = fs::absolute(run.config.task).lexically_normal().string();
    run.config.task = (path / kTaskFolder / task_files.front().path).string();
  }
  RunDirectory directory = RunDirectory::Create(path, SavedConfig(run.config, path), task_files);
  return {std::move(run.config), std::move(directory), std::move(learner)};
}

// Refuses what would make a resumed run another run than the one that was stopped.
void CheckResumeSettings(const LearnArguments& arguments, const std::vector<Setting>& settings) {
  const std::vector<std::string> allowed = {"--episodes", "--threads", "--until-solved",
                                            "--quiet",    "--json",    "--system"};
  const auto refuse = [&](const std::string& what) {
    throw InvalidInput(
        fmt::format("{} cannot be given with --resume, which goes on with the run's "
                    "own config.toml; allowed: {}",
                    what, fmt::join(allowed, ", ")));
  };
  if (!arguments.config_file.empty()) refuse("--config");
  for (const Setting& setting : settings) {
    if (setting.key == "task") continue;  // compared with the run's
    if (std::find(allowed.begin(), allowed.end(), setting.origin) == allowed.end()) {
      refuse(setting.origin);
    }
  }
}

// Said with --quiet, too: no file of the run tells it in words.
void WarnOfMixedBits(const Learner& learner) {
  const std::string difference = PlatformDifference(learner.state(), CurrentPlatform());
  if (learner.done() || difference.empty()) return;
  fmt::print(stderr, "downpour: warning: {}\n", difference);
}

OpenRun ResumedRun(const LearnArguments& arguments, bool shared) {
  const std::vector<Setting> given = CommandLineSettings(arguments);
  CheckResumeSettings(arguments, given);
  RunDirectory directory = RunDirectory::OpenForWriting(arguments.resume);
  const fs::path config_file = directory.path() / "config.toml";
  std::vector<Setting> settings = ReadConfigFile(config_file.string());
  const RunConfig saved = ResolveConfig(settings).config;
  const std::string task = IsTaskFile(saved.task) ? saved.task_source : saved.task;
  const bool same = IsTaskFile(saved.task) && IsTaskFile(arguments.task)
                        ? fs::path(arguments.task).filename() == fs::path(task).filename()
                        : arguments.task == task;
  if (!arguments.task.empty() && !same) {
    throw InvalidInput(fmt::format("TASK = {}: must be {}, the task of {}, or left out",
                                   arguments.task, task, arguments.resume));
  }
  CheckTaskFile(saved, arguments.task, directory.path());
  for (const Setting& setting : given) {
    if (setting.key != "task") settings.push_back(setting);
  }
  ResolvedRun run = ResolveConfig(settings);
  if (shared) CheckShareable(run.config);
  UseRobot(run.config, &run.task);
  UsePrior(run.config, &run.task);
  LearnerState state = directory.ReadState(run.task, run.config.learner);
  // A policy is written after the first checkpoint; starting anew would overwrite it.
  if (state.episodes.empty() && fs::exists(directory.path() / "policy.json")) {
    throw InvalidInput(fmt::format("{}: missing, though policy.json is there; must be the run's",
                                   (directory.path() / "checkpoint.json").string()));
  }
  Learner learner(run.task, run.config.learner, std::move(state));
  WarnOfMixedBits(learner);
  // The run's settings are from now on the ones it goes on with.
  if (!given.empty()) {
    WriteFileAtomically(config_file, SavedConfig(run.config, directory.path()));
  }
  directory.Write(learner);
  return {std::move(run.config), std::move(directory), std::move(learner)};
}

// "episodes 1 to 3 are kept in DIR; go on with: downpour learn --resume DIR"
std::string KeptMessage(const LearnerState& state, const LearnerOptions& options,
                        const std::string& program, const std::string& directory) {
  const std::size_t n = state.episodes.size();
  // An aborted episode may be the last one.
  const bool all_run = n >= static_cast<std::size_t>(options.episodes);
  const std::string kept = n == 0   ? "no episode was finished"
                           : n == 1 ? fmt::format("episode 1 is kept in {}", directory)
                                    : fmt::format("episodes 1 to {} are kept in {}", n, directory);
  return fmt::format("{}; go on with: {} learn --resume {}{}", kept, ShellWord(program),
                     ShellWord(directory), all_run ? fmt::format(" --episodes {}", n + 1) : "");
}

// The next episode; a system that fails before its first step leaves none.
const EpisodeRecord& RunEpisode(const Learner::Callbacks& callbacks, Learner* learner) {
  try {
    return learner->RunEpisode(callbacks);
  } catch (const SystemFailure& failure) {
    throw SystemFailure(fmt::format("episode {} {} before its first step: {}",
                                    learner->state().episodes.size() + 1, kAborted,
                                    failure.what()));
  }
}

void RunToTheEnd(OpenRun* run, MpiWorld* world) {
  Learner& learner = run->learner;
  const std::string directory = run->directory.path().string();
  InstallStopHandler();
  Progress progress(run->config);
  progress.Start(learner, directory);
  int threads = learner.options().rollout.threads;
  Learner::Callbacks callbacks;
  std::optional<SharedRollouts> shared;
  if (world->size() > 1 && !learner.done()) {
    callbacks.helpers = &shared.emplace(world, run->directory, threads);
    threads = shared->threads();
  }
  callbacks.phase = [&](const std::string& phase) { progress.Phase(learner, phase); };
  callbacks.search = [&](const PolicySearchProgress& search, const EvaluatorStatistics& batch) {
    progress.Search(search, batch, threads);
  };
  callbacks.pilco = [&](const GradientSearchProgress& search) { progress.Search(search); };
  callbacks.stop = &StopRequested();
  while (!learner.done()) {
    const EpisodeRecord& record = RunEpisode(callbacks, &learner);
    run->directory.Write(learner);
    progress.Episode(learner, record);
    if (!Aborted(record)) continue;
    if (StopRequested()) throw Interrupted();
    throw SystemFailure(fmt::format("episode {} {}", record.episode, record.outcome));
  }
  progress.Finish(learner, directory);
}

OpenRun Open(const LearnArguments& arguments, bool shared) {
  try {
    return arguments.resume.empty() ? NewRun(arguments, shared) : ResumedRun(arguments, shared);
  } catch (const Interrupted&) {  // while a robot got ready
    throw RunInterrupted("interrupted", StopSignal());
  }
}

void Learn(const LearnArguments& arguments) {
  MpiWorld world("learn");
  if (world.rank() > 0) return HelpWithRollouts(&world);
  OpenRun run = Open(arguments, world.size() > 1);
  const std::string directory = run.directory.path().string();
  const auto kept = [&](const LearnerState& state) {
    return KeptMessage(state, run.config.learner, arguments.program, directory);
  };
  try {
    RunToTheEnd(&run, &world);
  } catch (const Interrupted&) {
    throw RunInterrupted("interrupted; " + kept(run.learner.state()), StopSignal());
  } catch (const SystemFailure& failure) {
    throw SystemFailure(fmt::format("{}; {}", failure.what(), kept(run.learner.state())));
  } catch (const std::bad_alloc&) {
    throw std::runtime_error("out of memory; what is finished is kept: " +
                             kept(run.learner.state()));
  } catch (const FileError& error) {
    // The episode that could not be written is not among those kept.
    const LearnerState state = run.directory.ReadState(run.learner.task(), run.config.learner);
    throw FileError(fmt::format("{}; {}", error.what(), kept(state)));
  }
}

}  // namespace

void AddLearnCommand(CLI::App* app, const std::string& program) {
  CLI::App* command = app->add_subcommand("learn", "Learn a policy for a task from scratch");
  auto arguments = std::make_shared<LearnArguments>();
  arguments->program = program;
  command
      ->add_option("TASK", arguments->task,
                   "Task to learn, downpour tasks lists them, or FILE.toml")
      ->check(NotEmpty());
  command->add_option("--config", arguments->config_file, "TOML file of settings")
      ->type_name("FILE")
      ->check(NotEmpty());
  command->add_option("--set", arguments->assignments, "One setting by its TOML key; repeatable")
      ->type_name("KEY=VALUE")
      ->allow_extra_args(false);
  command->add_option("--resume", arguments->resume, "Run directory to go on with")
      ->type_name("RUN")
      ->check(NotEmpty());
  RunConfig defaults;
  for (const Field& field : ConfigFields(defaults)) {
    if (field.option.empty()) continue;
    const std::string help = WithDefault(
        fmt::format("{} [{}]", field.option_help.empty() ? field.description : field.option_help,
                    field.key),
        field);
    OptionValue& value = arguments->options[field.key];
    if (std::holds_alternative<bool*>(field.target)) {
      value.option = command->add_flag(field.option, value.flag, help);
    } else {
      const bool is_number = field.max > field.min;
      value.option =
          command->add_option(field.option, value.text, help)
              ->type_name(std::holds_alternative<std::vector<int>*>(field.target) ? "N,..."
                          : is_number                                             ? "N"
                          : field.choices.empty()                                 ? "PATH"
                                                                                  : "NAME");
      if (!is_number && field.choices.empty()) value.option->check(NotEmpty());
    }
  }
  command->footer(
      "Settings: the task's own, then --config, then --set, then the options; the key of an\n"
      "option is in brackets. config.toml in the run directory holds all of them, described.\n"
      "A run ends with the same results however often it is stopped and resumed on one machine\n"
      "(it warns if the SIMD target or the OpenBLAS kernels differ); --resume takes only\n"
      "--episodes, --threads, --until-solved, --quiet, --json and --system besides. A robot that\n"
      "fails ends the run with exit code 3; the steps it made are kept.");
  command->callback([arguments] { Learn(*arguments); });
}

}  // namespace downpour
