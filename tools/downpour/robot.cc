// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/robot.h"

#include <fmt/format.h>

#include <string>
#include <string_view>

#include "engine/errors.h"
#include "engine/robot/robot_system.h"
#include "engine/robot/split_words.h"
#include "tools/downpour/stop.h"

namespace downpour {
namespace {

constexpr std::string_view kExec = "exec:";

std::vector<std::string> Command(const std::string& program) {
  const auto fail = [&](const std::string& what) {
    throw InvalidInput(fmt::format(
        "--system: system.program = {}: {}; e.g. \"exec:python3 my_robot.py\"", program, what));
  };
  if (!program.starts_with(kExec)) fail("must begin with exec:");
  try {
    return SplitWords(program.substr(kExec.size()));
  } catch (const InvalidInput& error) {
    fail(error.what());
    throw;
  }
}

}  // namespace

void UseRobot(const RunConfig& config, Task* task) {
  const SystemConfig& system = config.system;
  if (system.program.empty()) return;
  RobotOptions options;
  options.command = Command(system.program);
  options.step_timeout = system.timeout;
  options.setup_timeout = system.setup_timeout;
  options.stop = &StopRequested();
  if (!config.mjcf.empty()) {
    throw InvalidInput(fmt::format(
        "mjcf = {}: must be empty with --system, which simulates nothing", config.mjcf));
  }
  if (config.observation_std >= 0) {
    throw InvalidInput(
        fmt::format("observation_std = {}: must be negative with --system: a robot's sensors have "
                    "their own noise",
                    config.observation_std));
  }
  InstallStopHandler();
  task->model_digest.clear();
  task->make_system = [simulated = *task, options] { return MakeRobotSystem(simulated, options); };
}

}  // namespace downpour
