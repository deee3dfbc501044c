// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "tasks/mujoco_system.h"

namespace downpour {

// Task::model_digest of `spec`: of its MJCF text, built in or from its file, and of the files that
// the text names by a `file` attribute (includes, meshes, ...) and that lie at that path from the
// MJCF file's folder; files below a meshdir or texturedir are not looked at. "" if the MJCF file
// cannot be read: MakeMujocoSystem says why. Thread-safe.
std::string ModelDigest(const MujocoSystemSpec& spec);

}  // namespace downpour
