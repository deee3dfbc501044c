// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <CLI/App.hpp>
#include <stdexcept>

namespace downpour {

// A learning run ended by Ctrl-C. what() says what was kept and how to go on.
class RunInterrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// Each adds one subcommand, which runs while the command line is parsed and throws the exceptions
// of engine/errors.h.
void AddLearnCommand(CLI::App* app);
void AddEvaluateCommand(CLI::App* app);
void AddTasksCommand(CLI::App* app);
void AddDoctorCommand(CLI::App* app);

}  // namespace downpour
