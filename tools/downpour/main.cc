// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <csignal>
#include <cstdio>
#include <exception>
#include <new>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/gp/process_settings.h"
#include "engine/learner/suggest.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/mpi_world.h"

namespace downpour {
namespace {

constexpr int kBadInput = 2;
constexpr int kOtherFailure = 1;
constexpr int kRobotFailure = 3;
constexpr int kSignalled = 128;  // + the signal, as shells have it: 130 SIGINT, 143 SIGTERM

int Fail(std::string message, int exit_code) {
  while (!message.empty() && message.back() == '\n') message.pop_back();
  std::replace(message.begin(), message.end(), '\n', ' ');
  std::fputs(fmt::format("downpour: {}\n", message).c_str(), stderr);
  return exit_code;
}

// The subcommand that was given, or the program itself.
CLI::App* ParsedCommand(CLI::App* app) {
  const std::vector<CLI::App*> commands = app->get_subcommands();
  return commands.empty() ? app : commands.front();
}

// What was wrong with the command line, and what is allowed.
std::string CommandLineMessage(CLI::App* app, const CLI::ParseError& error) {
  CLI::App* command = ParsedCommand(app);
  const std::vector<std::string> unexpected = app->remaining(true);
  const bool is_unexpected = dynamic_cast<const CLI::ExtrasError*>(&error) != nullptr ||
                             command == app;  // an unknown command reads as a missing one
  if (!is_unexpected || unexpected.empty()) {
    return fmt::format("{}; see downpour {}{}--help", error.what(),
                       command == app ? "" : command->get_name(), command == app ? "" : " ");
  }
  const std::string& name = unexpected.front();
  std::vector<std::string> allowed;
  if (command == app && name.front() != '-') {
    for (const CLI::App* each : app->get_subcommands({})) allowed.push_back(each->get_name());
    return fmt::format("unknown command {}; {}", name, Suggest(name, allowed));
  }
  if (name.front() != '-') return fmt::format("unexpected argument {}", name);
  for (const CLI::Option* option : command->get_options()) {
    if (!option->get_lnames().empty()) allowed.push_back("--" + option->get_lnames().front());
  }
  return fmt::format("unknown option {}; {}", name, Suggest(name, allowed));
}

int Run(int argc, char** argv) {
  CLI::App app("Downpour learns control policies from seconds of robot time (Black-DROPS).",
               "downpour");
  app.set_version_flag("--version", "downpour " DOWNPOUR_VERSION);
  app.require_subcommand(1);
  AddLearnCommand(&app, argv[0]);
  AddEvaluateCommand(&app);
  AddActCommand(&app);
  AddExportCommand(&app);
  AddPredictCommand(&app);
  AddPlotCommand(&app);
  AddRenderCommand(&app);
  AddStudyCommand(&app, argv[0]);
  AddReportCommand(&app);
  AddTasksCommand(&app);
  AddSimulateCommand(&app);
  AddDoctorCommand(&app);
  AddProfileCommand(&app);
  AddScalingCommand(&app);
  // Last, as a subcommand would inherit it.
  app.footer(
      "Examples:\n"
      "  downpour learn cartpole                    learn, into runs/cartpole-seed0\n"
      "  downpour evaluate runs/cartpole-seed0      try the learnt policy from 100 noisy starts\n"
      "  downpour act runs/cartpole-seed0           states in, actions out\n"
      "  downpour plot runs/cartpole-seed0          how it was learnt, as a picture\n"
      "  downpour render runs/cartpole-seed0        the last episode, as a filmstrip\n"
      "  downpour study study.toml                  many seeds and settings, for downpour report\n"
      "Exit codes: 0 fine, 2 bad input, 3 the robot failed, 130 interrupted (Ctrl-C), 143 "
      "terminated, 1 any other failure.");
  try {
    app.parse(argc, argv);
    if (std::fflush(stdout) != 0) throw FileError("standard output: cannot write");
    return 0;
  } catch (const CLI::Success& success) {  // --help, --version
    return app.exit(success);
  } catch (const CLI::ParseError& error) {
    if (!TellsCommandLineErrors()) return kBadInput;
    return Fail(CommandLineMessage(&app, error), kBadInput);
  } catch (const RunInterrupted& interrupted) {
    return Fail(interrupted.what(), kSignalled + interrupted.signal());
  } catch (const InvalidInput& error) {
    return Fail(error.what(), kBadInput);
  } catch (const FileError& error) {
    return Fail(error.what(), kBadInput);
  } catch (const SystemFailure& error) {
    return Fail(error.what(), kRobotFailure);
  } catch (const std::bad_alloc&) {
    return Fail("out of memory", kOtherFailure);
  } catch (const std::exception& error) {
    return Fail(error.what(), kOtherFailure);
  }
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  downpour::PrepareProcess(argv);
  std::signal(SIGXFSZ, SIG_IGN);  // a limit on file sizes shall give an error, not a signal
  return downpour::Run(argc, argv);
}
