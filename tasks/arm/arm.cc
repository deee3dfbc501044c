// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cmath>
#include <memory>
#include <numbers>
#include <span>
#include <sstream>
#include <string>

#include "engine/rollout/reward.h"
#include "engine/rollout/task.h"
#include "kernels/aligned.h"
#include "tasks/mujoco_system.h"
#include "tasks/mujoco_task.h"
#include "tasks/solved.h"

namespace downpour::arm {

const char* Mjcf();  // arm.xml

namespace {

constexpr int kJoints = 4;

// m, as in arm.xml: the first pitch joint above the ground, and the links from it on.
constexpr double kShoulderHeight = 0.0545 + 0.123;
constexpr std::array kLinks = {0.317, 0.202, 0.1605};

struct Angle {
  double cosine, sine;
};
using Angles = std::array<Angle, kJoints>;
using Position = std::array<double, 3>;  // m

// The pitch angles add up along the arm in a vertical plane, which joint 0 turns.
Position EndEffector(const Angles& angles) {
  double reach = 0, height = kShoulderHeight;
  Angle pitch = {1, 0};
  for (int link = 0; link < kJoints - 1; ++link) {
    const Angle& joint = angles[link + 1];
    pitch = {pitch.cosine * joint.cosine - pitch.sine * joint.sine,
             pitch.sine * joint.cosine + pitch.cosine * joint.sine};
    reach += kLinks[link] * pitch.sine;
    height += kLinks[link] * pitch.cosine;
  }
  return {reach * angles[0].cosine, reach * angles[0].sine, height};
}

Position EndEffectorOf(std::span<const double> state) {
  Angles angles;
  for (int j = 0; j < kJoints; ++j) angles[j] = {std::cos(state[j]), std::sin(state[j])};
  return EndEffector(angles);
}

Position Target() {
  constexpr double kEighth = std::numbers::pi / 8;
  return EndEffectorOf(std::array{2 * kEighth, kEighth, kEighth, kEighth});
}

double Distance(const Position& a, const Position& b) {
  return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

// Paper: exp(-d / (2 width^2)); authors' code: exp(-d^2 / (2 width^2)); d the distance of the
// end-effector from the target.
class DistanceReward final : public Reward {
 public:
  DistanceReward(bool squared, double width)
      : squared_(squared), width_(width), target_(Target()) {}

  std::string Describe() const override {
    std::ostringstream text;
    text << "exp(-d" << (squared_ ? "^2" : "") << " / (2 x " << width_ << "^2)), d = distance in m "
         << "of the end-effector from where it is at the angles (pi/4, pi/8, pi/8, pi/8)";
    return text.str();
  }
  bool InUnitInterval() const override { return true; }

  void EvaluateTile(int, const double*, const double* features, const double*,
                    double* rewards) const override {
    for (int lane = 0; lane < kTileLanes; ++lane) {
      const double* const feature = features + lane;  // cosine and sine of each joint in turn
      Angles angles;
      for (int j = 0; j < kJoints; ++j) {
        angles[j] = {feature[2 * j * kTileLanes], feature[(2 * j + 1) * kTileLanes]};
      }
      const double distance = Distance(EndEffector(angles), target_);
      rewards[lane] =
          std::exp(-(squared_ ? distance * distance : distance) / (2 * width_ * width_));
    }
  }

 private:
  bool squared_;
  double width_;
  Position target_;
};

MujocoSystemSpec SystemSpec(const std::string& mjcf_file, const Task& task) {
  MujocoSystemSpec spec{.name = "arm.xml (built in)", .mjcf = Mjcf(), .mjcf_file = mjcf_file};
  for (int joint = 0; joint < kJoints; ++joint) {
    spec.joints.push_back("joint_" + std::to_string(joint));
    spec.states.push_back({joint, JointQuantity::kPosition});
    spec.actuators.push_back("velocity_" + std::to_string(joint));
  }
  spec.action_limits = task.action_limits;
  spec.control_period = task.control_period;
  return spec;
}

}  // namespace

Task Make(const std::string& preset, const std::string& mjcf_file) {
  Task task;
  task.name = "arm";
  task.description = "bring the end-effector of a velocity-controlled arm to a place, and keep it";
  task.preset = preset;
  for (int joint = 0; joint < kJoints; ++joint) {
    const std::string number = std::to_string(joint);
    task.states.push_back({"joint_" + number, "rad"});
    task.features.push_back({FeatureKind::kCosine, joint});
    task.features.push_back({FeatureKind::kSine, joint});
    task.feature_names.push_back({"cos_joint_" + number, "1"});
    task.feature_names.push_back({"sin_joint_" + number, "1"});
    task.actions.push_back({"velocity_" + number, "rad/s"});
  }
  task.action_limits.assign(kJoints, 1);
  task.start_mean.assign(kJoints, 0);
  task.start_std.assign(kJoints, 0);
  task.observation_std.assign(kJoints, 0);
  task.policy_input_scale.assign(2 * kJoints, 1);
  task.parameter_bound = 1;
  task.search_first_sigma = 0.2;
  task.search_restart_sigma = 1;
  task.search_restart_decades = 1;
  task.control_period = 0.1;
  task.horizon = 40;
  const bool paper = preset == "paper";
  task.reward = std::make_shared<DistanceReward>(!paper, paper ? 0.1 : 0.2);
  task.learn_reward = true;
  task.solved = [target = Target(), period = task.control_period](std::span<const double> states) {
    return HoldsThroughLastSecond(states, kJoints, period, [&](std::span<const double> state) {
      return Distance(EndEffectorOf(state), target) < 0.1;
    });
  };
  task.solved_description = "end-effector within 0.1 m of the target throughout the last second";
  SimulateByMujoco(SystemSpec(mjcf_file, task), &task);
  return task;
}

}  // namespace downpour::arm
