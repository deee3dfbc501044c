// SPDX-License-Identifier: Apache-2.0
#include "tasks/mujoco_task.h"

#include "tasks/model_digest.h"
#include "tasks/mujoco_prior.h"

namespace downpour {

void SimulateByMujoco(const MujocoSystemSpec& spec, Task* task) {
  task->model_digest = ModelDigest(spec);
  task->make_system = [spec] { return MakeMujocoSystem(spec); };
  task->make_prior = MujocoPriorMaker(spec);
}

}  // namespace downpour
