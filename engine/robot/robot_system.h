// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "engine/rollout/task.h"

namespace downpour {

// Version of the protocol that docs/robot.md describes.
inline constexpr int kRobotProtocol = 1;
// Largest |number| that a robot may send where it names no limit of its own.
inline constexpr double kRobotLimit = 1e6;

struct RobotOptions {
  std::vector<std::string> command;  // program and arguments
  double step_timeout = 0;           // s for the answer to an action; 0: five control periods
  double setup_timeout = 60;         // s for the answers to hello and reset
  const std::atomic<bool>* stop = nullptr;  // a request to stop; may be null
};

// The hello of the learner: what `task` takes the robot to be.
nlohmann::ordered_json RobotHello(const Task& task);

// One line of the protocol as an object. Throws SystemFailure, with the start of the line, if it is
// no JSON object, nests deeper than any message does, or has a number beyond the range of a double.
nlohmann::json ParseRobotLine(const std::string& line);

// Starts the program and says hello. The system is measured (System::measured): observations and
// optional rewards are the program's. Failing, or asked to stop, it tells the program to close,
// ends it (LineProcess::Close) and throws SystemFailure or Interrupted; the next Begin starts the
// program again. Throws InvalidInput if the program cannot be started or its robot does not suit
// the task; SystemFailure and Interrupted if it does not answer.
std::unique_ptr<System> MakeRobotSystem(const Task& task, const RobotOptions& options);

}  // namespace downpour
