// SPDX-License-Identifier: Apache-2.0
#include <memory>
#include <span>
#include <string>

#include "engine/rollout/reward.h"
#include "engine/rollout/task.h"
#include "tasks/mujoco_system.h"
#include "tasks/mujoco_task.h"
#include "tasks/solved.h"

namespace downpour::pendulum {

const char* Mjcf();  // pendulum.xml

namespace {

enum State { kAngularVelocity, kAngle, kStates };

// d^2 = (cos + 1)^2 + sin^2, the squared distance of the unit pole's tip from upright.
std::shared_ptr<const Reward> TipReward(const Task& task, double width) {
  return MakeSaturatingReward(task.feature_names, {0, 1, 0, 0, 0, 1}, {-1, 0}, width);
}

MujocoSystemSpec SystemSpec(const std::string& mjcf_file, const Task& task) {
  return {.name = "pendulum.xml (built in)",
          .mjcf = Mjcf(),
          .mjcf_file = mjcf_file,
          .joints = {"pole"},
          .states = {{0, JointQuantity::kVelocity}, {0, JointQuantity::kPosition}},
          .actuators = {"torque"},
          .action_limits = task.action_limits,
          .control_period = task.control_period};
}

}  // namespace

Task Make(const std::string& preset, const std::string& mjcf_file) {
  Task task;
  task.name = "pendulum";
  task.description = "swing a torque-limited pendulum up and balance it";
  task.preset = preset;
  task.states = {{"angular_velocity", "rad/s"}, {"angle", "rad"}};
  task.features = {{FeatureKind::kIdentity, kAngularVelocity},
                   {FeatureKind::kCosine, kAngle},
                   {FeatureKind::kSine, kAngle}};
  task.feature_names = {{"angular_velocity", "rad/s"}, {"cos_angle", "1"}, {"sin_angle", "1"}};
  task.actions = {{"torque", "N m"}};
  task.action_limits = {2.5};
  task.start_mean = {0, 0};
  task.start_std = {0, 0};
  task.observation_std = {0, 0};
  task.policy_input_scale = {10, 1, 1};
  task.parameter_bound = 5;
  task.policy_points = 10;
  task.search_first_sigma = 1;
  task.search_restart_sigma = 2.2;
  task.search_restart_decades = 0.2;
  task.control_period = 0.1;
  task.horizon = 40;
  task.reward = TipReward(task, preset == "paper" ? 0.25 : 0.5);
  task.solved = [period = task.control_period](std::span<const double> states) {
    return HoldsThroughLastSecond(states, kStates, period, [](std::span<const double> state) {
      return IsUpright(state[kAngle]);
    });
  };
  task.solved_description = "pole within 10 degrees of upright throughout the last second";
  SimulateByMujoco(SystemSpec(mjcf_file, task), &task);
  return task;
}

}  // namespace downpour::pendulum
