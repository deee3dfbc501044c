// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "engine/learner/json_field.h"
#include "engine/robot/robot_system.h"
#include "engine/rollout/reward.h"
#include "kernels/philox/philox.h"
#include "tasks/registry.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"

namespace downpour {
namespace {

using Json = nlohmann::json;
using OrderedJson = nlohmann::ordered_json;

struct SimulateArguments {
  std::string task;
  std::string preset;  // "": the task's own
  std::string mjcf;
  std::uint64_t seed = 0;
};

// The task's simulator as a robot. Its sensors have the noise that a learner with the same seed
// adds to the states of its own simulator, so that both learn from the same numbers.
class SimulatedRobot {
 public:
  SimulatedRobot(Task task, std::uint64_t seed)
      : task_(std::move(task)),
        seed_(seed),
        system_(task_.make_system()),
        state_(task_.states.size()) {}

  OrderedJson Hello() const {
    return {{"type", "hello"},
            {"protocol", kRobotProtocol},
            {"name", "downpour simulate " + task_.name},
            {"n_states", task_.n_states()},
            {"n_actions", task_.n_actions()},
            {"control_period", task_.control_period},
            {"action_limits", task_.action_limits}};
  }

  OrderedJson Reset(const JsonField& message) {
    episode_ = message["episode"].Int(1, 1000000);
    state_ = Numbers(message["start"], state_.size());
    running_ = true;
    const std::vector<double> start = state_;
    system_->Begin(episode_, start, state_);
    return {{"type", "start"}, {"episode", episode_}, {"observation", Observation(0)}};
  }

  OrderedJson Step(const JsonField& message) {
    if (!running_) throw InvalidInput("a step before a reset: must be behind one");
    const int step = message["step"].Int(0, 1000000000);
    const std::vector<double> action = Numbers(message["action"], task_.actions.size());
    system_->Step(action, state_);
    for (const double value : state_) {
      if (!std::isfinite(value)) throw SystemFailure("the simulation became unstable");
    }
    return {{"type", "observation"},
            {"step", step},
            {"observation", Observation(static_cast<std::uint32_t>(step) + 1)},
            {"reward", ComputeReward(task_, step, state_, action)}};
  }

 private:
  static std::vector<double> Numbers(const JsonField& field, std::size_t n) {
    std::vector<double> numbers = field.Numbers();
    if (numbers.size() != n) field.Fail(fmt::format("an array of {} numbers", n));
    return numbers;
  }

  std::vector<double> Observation(std::uint32_t time) const {
    std::vector<double> observation(state_.size());
    FillNormals(
        DeriveKey(seed_, StreamPurpose::kObservationNoise, {static_cast<std::uint32_t>(episode_)}),
        time, observation.data(), observation.size());
    for (std::size_t i = 0; i < state_.size(); ++i) {
      observation[i] = state_[i] + task_.observation_std[i] * observation[i];
    }
    return observation;
  }

  Task task_;
  std::uint64_t seed_;
  std::unique_ptr<System> system_;
  std::vector<double> state_;
  int episode_ = 1;
  bool running_ = false;
};

// The answer to one line; null if it takes none.
OrderedJson Answer(const std::string& line, SimulatedRobot* robot) {
  try {
    const Json message = ParseRobotLine(line);
    const JsonField root(message, "downpour simulate");
    const std::string type = root["type"].String();
    if (type == "hello") return robot->Hello();
    if (type == "reset") return robot->Reset(root);
    if (type == "step") return robot->Step(root);
    if (type != "end") root["type"].Fail("one of hello, reset, step, end, close");
    return nullptr;
  } catch (const std::runtime_error& error) {
    return {{"type", "error"}, {"message", error.what()}};
  }
}

void Simulate(const SimulateArguments& arguments) {
  SimulatedRobot robot(MakeTask(arguments.task, arguments.preset, arguments.mjcf), arguments.seed);
  for (std::string line; std::getline(std::cin, line);) {
    if (line == R"({"type":"close"})") return;
    const OrderedJson answer = Answer(line, &robot);
    if (answer.is_null()) continue;
    fmt::print("{}\n", answer.dump());
    if (std::fflush(stdout) != 0) throw FileError("standard output: cannot write");
  }
}

}  // namespace

void AddSimulateCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand(
      "simulate", "Be the task's robot: simulate it by the protocol of docs/robot.md");
  auto arguments = std::make_shared<SimulateArguments>();
  command
      ->add_option("TASK", arguments->task,
                   "Task to simulate, downpour tasks lists them, or FILE.toml")
      ->required()
      ->check(NotEmpty());
  command->add_option("--preset", arguments->preset, "paper or original-code")
      ->capture_default_str();
  command->add_option("--mjcf", arguments->mjcf, "MJCF file in place of the task's own")
      ->type_name("FILE")
      ->check(NotEmpty());
  command->add_option("--seed", arguments->seed, "Seed of the sensors' noise (default 0)")
      ->type_name("N");
  command->callback([arguments] { Simulate(*arguments); });
}

}  // namespace downpour
