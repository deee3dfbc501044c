// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/mpi_world.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/shell.h"
#include "tools/downpour/stop.h"
#include "tools/downpour/study_file.h"
#include "tools/downpour/study_ranks.h"
#include "tools/downpour/study_runner.h"

namespace downpour {
namespace {

struct StudyArguments {
  std::string program;  // as typed
  std::string file;
  std::string database;
  std::string share;
};

// "2/8", the second of eight.
StudyShare ReadShare(const std::string& text) {
  StudyShare share;
  char end = 0;
  if (text.empty()) return share;
  if (std::sscanf(text.c_str(), "%d/%d%c", &share.index, &share.count, &end) != 2 ||
      share.index < 1 || share.count < share.index) {
    throw InvalidInput(fmt::format("--share {}: must be I/N with 1 <= I <= N, e.g. 1/8", text));
  }
  return share;
}

void RunStudy(const StudyArguments& arguments, const std::vector<Setting>& settings) {
  namespace fs = std::filesystem;
  MpiWorld world("study");
  if (world.rank() > 0) return HelpWithStudy(&world);
  const StudyShare share = ReadShare(arguments.share);
  Study study = ReadStudyFile(arguments.file);
  ApplySettings(JobFields(&study), settings);
  const std::string database = arguments.database.empty()
                                   ? fs::path(arguments.file).replace_extension(".db").string()
                                   : arguments.database;
  StudyRunner runner(arguments.program, std::move(study), database,
                     fs::path(database).replace_extension(".runs"), share, &world);
  InstallStopHandler();
  if (!runner.Run()) {
    std::string command =
        fmt::format("{} study {}", ShellWord(arguments.program), ShellWord(arguments.file));
    if (!arguments.database.empty()) command += " --database " + ShellWord(database);
    if (!arguments.share.empty()) command += " --share " + arguments.share;
    for (const Setting& setting : settings) {
      command += fmt::format(" {} {}", setting.origin, ShellWord(setting.text));
    }
    throw RunInterrupted(fmt::format("interrupted; {} of {} runs are finished; go on with: {}",
                                     runner.n_finished(), runner.n_runs(), command),
                         StopSignal());
  }
  if (share.count > 1) {
    fmt::print(stderr, "{} of {} runs of share {} are finished in {}\n", runner.n_finished(),
               runner.n_runs(), arguments.share,
               fs::path(database).replace_extension(".runs").string());
    return;
  }
  fmt::print(stderr, "{} of {} runs are finished in {}; draw them with: {} report {}\n",
             runner.n_finished(), runner.n_runs(), database, ShellWord(arguments.program),
             ShellWord(database));
}

}  // namespace

void AddStudyCommand(CLI::App* app, const std::string& program) {
  CLI::App* command =
      app->add_subcommand("study", "Learn with many seeds and settings, for comparison");
  auto arguments = std::make_shared<StudyArguments>();
  auto settings = std::make_shared<std::vector<Setting>>();
  arguments->program = program;
  command->add_option("STUDY", arguments->file, "TOML file of the study")
      ->type_name("FILE")
      ->required()
      ->check(NotEmpty());
  command
      ->add_option("--database", arguments->database,
                   "SQLite file of the results (default STUDY with .db for .toml)")
      ->type_name("FILE")
      ->check(NotEmpty());
  command
      ->add_option("--share", arguments->share,
                   "Only every N-th run from the I-th on, without a database; others run theirs\n"
                   "(docs/cluster.md)")
      ->type_name("I/N")
      ->check(NotEmpty());
  Study defaults;
  AddFieldOptions(command, JobFields(&defaults), settings);
  command->footer(
      "Every run is a run directory beside the database, STUDY.runs/TASK/VARIANT/SEED. However\n"
      "the command ends, the same command goes on with what is missing; docs/studies.md has an\n"
      "example and the tables of the database.");
  command->callback([arguments, settings] { RunStudy(*arguments, *settings); });
}

}  // namespace downpour
