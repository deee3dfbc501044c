// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <memory>
#include <span>
#include <string>

#include "engine/rollout/reward.h"
#include "engine/rollout/task.h"
#include "tasks/mujoco_system.h"
#include "tasks/mujoco_task.h"
#include "tasks/solved.h"

namespace downpour::cartpole {

const char* Mjcf();  // cartpole.xml

namespace {

constexpr double kPoleLength = 0.5;  // m, as in cartpole.xml

enum State { kCartVelocity, kCartPosition, kPoleVelocity, kPoleAngle, kStates };

// Paper: d^2 = x^2 + (cos + 1)^2 + sin^2, a pole of unit length whose x and sin are not coupled.
std::shared_ptr<const Reward> PaperReward(const Task& task) {
  return MakeSaturatingReward(task.feature_names,
                              {0, 1, 0, 0, 0,   //
                               0, 0, 0, 1, 0,   //
                               0, 0, 0, 0, 1},  //
                              {0, -1, 0}, 0.25);
}

// Authors' code: d^2 = (x + l sin)^2 + (l cos + l)^2, the tip's squared distance from (0, l).
std::shared_ptr<const Reward> TipReward(const Task& task) {
  return MakeSaturatingReward(task.feature_names,
                              {0, 1, 0, 0, kPoleLength,   //
                               0, 0, 0, kPoleLength, 0},  //
                              {0, -kPoleLength}, 0.25);
}

MujocoSystemSpec SystemSpec(const std::string& mjcf_file, const Task& task) {
  return {.name = "cartpole.xml (built in)",
          .mjcf = Mjcf(),
          .mjcf_file = mjcf_file,
          .joints = {"cart", "pole"},
          .states = {{0, JointQuantity::kVelocity},
                     {0, JointQuantity::kPosition},
                     {1, JointQuantity::kVelocity},
                     {1, JointQuantity::kPosition}},
          .actuators = {"force"},
          .action_limits = task.action_limits,
          .control_period = task.control_period};
}

}  // namespace

Task Make(const std::string& preset, const std::string& mjcf_file) {
  const bool paper = preset == "paper";
  const double start_std = paper ? 0 : 0.001;
  Task task;
  task.name = "cartpole";
  task.description = "swing the pole of a cart up and balance it at the middle of the rail";
  task.preset = preset;
  task.states = {{"cart_velocity", "m/s"},
                 {"cart_position", "m"},
                 {"pole_velocity", "rad/s"},
                 {"pole_angle", "rad"}};
  task.features = {{FeatureKind::kIdentity, kCartVelocity},
                   {FeatureKind::kIdentity, kCartPosition},
                   {FeatureKind::kIdentity, kPoleVelocity},
                   {FeatureKind::kCosine, kPoleAngle},
                   {FeatureKind::kSine, kPoleAngle}};
  task.feature_names = {{"cart_velocity", "m/s"},
                        {"cart_position", "m"},
                        {"pole_velocity", "rad/s"},
                        {"cos_pole_angle", "1"},
                        {"sin_pole_angle", "1"}};
  task.actions = {{"force", "N"}};
  task.action_limits = {10};
  task.start_mean = {0, 0, 0, 0};
  task.start_std = {start_std, start_std, start_std, start_std};
  task.observation_std = {0.01, 0.01, 0.01, 0.01};
  task.policy_input_scale = {5, 5, 10, 1, 1};
  task.parameter_bound = 5;
  task.policy_points = 20;
  task.search_first_sigma = 0.25;
  task.search_restart_sigma = 2.5;
  task.search_restart_decades = 1;
  task.control_period = 0.1;
  task.horizon = 40;
  task.reward = paper ? PaperReward(task) : TipReward(task);
  task.solved = [period = task.control_period](std::span<const double> states) {
    return HoldsThroughLastSecond(states, kStates, period, [](std::span<const double> state) {
      return IsUpright(state[kPoleAngle]) && std::abs(state[kCartPosition]) < 0.1;
    });
  };
  task.solved_description =
      "pole within 10 degrees of upright and cart within 0.1 m of the middle throughout the last "
      "second";
  SimulateByMujoco(SystemSpec(mjcf_file, task), &task);
  return task;
}

}  // namespace downpour::cartpole
