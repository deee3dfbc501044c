// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "engine/rollout/task.h"

struct mjModel_;
struct mjData_;

namespace downpour {

// One state variable of a system: the position or the velocity of joints[joint], or, where a name
// is given, `component` of that sensor's reading or of that site's place in the world (m).
enum class JointQuantity { kPosition, kVelocity };
struct JointState {
  int joint;
  JointQuantity quantity;
  std::string sensor = "", site = "";
  int component = 0;
};

// A MuJoCo model as a downpour::System. Joints are slides (m) or hinges (rad, not wrapped).
struct MujocoSystemSpec {
  std::string name;                    // of the built-in model, for messages
  std::string mjcf;                    // the built-in model, MJCF text
  std::string mjcf_file;               // read instead of `mjcf` when not empty
  std::vector<std::string> joints;     // all joints of the model, by name
  bool other_joints = false;           // the model may have joints besides: they are no states
  std::vector<JointState> states;      // in the order of Task::states
  std::vector<std::string> actuators;  // all actuators, by name, in the order of Task::actions
  std::vector<double> action_limits;   // Task::action_limits
  double control_period = 0.1;         // s, a whole number of the model's timesteps
};

// The compiled model of spec.mjcf_file or spec.mjcf alone, whatever is in it. Throws InvalidInput,
// one line with the model's name, if it cannot be read or compiled. Thread-safe.
std::unique_ptr<mjModel_, void (*)(mjModel_*)> LoadMujocoModel(const MujocoSystemSpec& spec);

// What MakeMujocoSystem returns, for those who want to look at it.
class MujocoSystem : public System {
 public:
  virtual mjModel_& model() = 0;
  virtual mjData_& data() = 0;
  // As Step; calls `observe` after every timestep of the model.
  virtual void StepObserved(std::span<const double> action, std::span<double> state,
                            const std::function<void()>& observe) = 0;
  // The next steps have the same bits as after Reset, in some 10 ns where MuJoCo clears 3 MB in 0.1
  // ms: it sets all that they depend on, as long as nobody else has written to data(). Joints that
  // are no states are where the model has them, at rest. Does not allocate.
  virtual void Place(std::span<const double> state) = 0;
};

// Loads the model and returns a system at the model's own start. An action is held for the whole
// control period (zero-order hold) while the integrator and timestep of the MJCF advance the state.
// Throws InvalidInput, one line with the model's name, if the MJCF cannot be read or compiled, if
// its joints or actuators are not exactly those named, if an actuator's limited control range is
// narrower than the action limits, if a joint is no slide or hinge, or if its timestep does not
// divide the control period; for a sensor or site that the model lacks, too.
//
// Joints that are no states start where the model has them, at rest. Sensors and sites follow from
// the joints: Reset takes no notice of their states, and Begin writes what they are.
//
// Step writes NaN to every state variable when MuJoCo finds the simulation unstable (a position,
// velocity, acceleration or action that is not finite or is beyond 1e10), and goes on doing so
// until the next Reset. Step does not allocate. Equal states and actions after Reset give equal
// bits. Loading is thread-safe. The first load installs process-wide MuJoCo handlers: its warnings
// are dropped (so that no MUJOCO_LOG.TXT appears) and its errors become InvalidInput.
std::unique_ptr<MujocoSystem> MakeMujocoSystem(const MujocoSystemSpec& spec);

}  // namespace downpour
