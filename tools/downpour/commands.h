// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <CLI/App.hpp>
#include <stdexcept>
#include <string>

namespace downpour {

// A learning run ended by a signal, SIGINT (Ctrl-C) or SIGTERM. what() says what was kept and how
// to go on.
class RunInterrupted : public std::runtime_error {
 public:
  RunInterrupted(const std::string& what, int signal) : std::runtime_error(what), signal_(signal) {}
  int signal() const { return signal_; }

 private:
  int signal_;
};

// Each adds one subcommand, which runs while the command line is parsed and throws the exceptions
// of engine/errors.h.
// `program` is the program as typed, for the command that goes on with a stopped run or study.
void AddLearnCommand(CLI::App* app, const std::string& program);
void AddEvaluateCommand(CLI::App* app);
void AddActCommand(CLI::App* app);
void AddExportCommand(CLI::App* app);
void AddPredictCommand(CLI::App* app);
void AddPlotCommand(CLI::App* app);
void AddRenderCommand(CLI::App* app);
void AddStudyCommand(CLI::App* app, const std::string& program);
void AddReportCommand(CLI::App* app);
void AddTasksCommand(CLI::App* app);
void AddSimulateCommand(CLI::App* app);
void AddDoctorCommand(CLI::App* app);
void AddProfileCommand(CLI::App* app);
void AddScalingCommand(CLI::App* app);

}  // namespace downpour
