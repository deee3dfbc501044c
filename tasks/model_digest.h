// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "tasks/mujoco_system.h"

namespace downpour {

// The MJCF file and the files that it, and they in turn, name by a `file` attribute (includes,
// meshes, ...) and that lie at that path from the MJCF file's folder, or from its meshdir or
// texturedir; each once, in the order of their names in the text. None that cannot be read, the
// MJCF file itself included: MakeMujocoSystem says why. Thread-safe.
std::vector<std::filesystem::path> ModelFiles(const std::filesystem::path& mjcf_file);

// Task::model_digest of `spec`: of its MJCF text, built in, or of the texts of its ModelFiles. ""
// if the MJCF file cannot be read. Thread-safe.
std::string ModelDigest(const MujocoSystemSpec& spec);

}  // namespace downpour
