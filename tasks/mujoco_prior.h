// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "engine/rollout/dynamics_prior.h"
#include "tasks/mujoco_system.h"

namespace downpour {

// A MuJoCo model as a prior of the dynamics (docs/priors.md). spec: of the task's own system, but
// with mjcf_file that of the prior; its joints, actuators, states and control period hold for the
// prior, too. `free` lists its free parameters, separated by commas:
//   OBJECT:QUANTITY           from half to twice the model's own value, which must not be 0
//   OBJECT:QUANTITY=LOW..HIGH in the units of MJCF; the model's own value must lie in it
//     mass      of a body, kg; its inertia goes with it
//     length    of a body, as a factor of the model's own: centre of mass and what is attached to
//               the body go with it, its inertia with the square; geoms stay as they are
//     damping, friction (loss), stiffness, armature  of a joint
//     gear      of an actuator, its first number
// Between two steps nothing but the state is kept: a joint that is no state is where the model has
// it, at rest. Throws InvalidInput, one line, as MakeMujocoSystem does and for a list that names an
// object or a quantity that is not there, twice the same, or a range that is none, and for a spec
// with states of sensors or sites. Its predictors throw InvalidInput when they are made, if the
// file has been changed by then.
std::shared_ptr<const DynamicsPrior> MakeMujocoPrior(const MujocoSystemSpec& spec,
                                                     const std::string& free);

// Task::make_prior of a task whose system is that of `spec`.
std::function<std::shared_ptr<const DynamicsPrior>(const std::string& mjcf_file,
                                                   const std::string& free)>
MujocoPriorMaker(const MujocoSystemSpec& spec);

}  // namespace downpour
