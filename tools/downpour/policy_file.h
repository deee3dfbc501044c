// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "engine/learner/saved_policy.h"

namespace downpour {

struct LoadedPolicy {
  SavedPolicy saved;
  Task task;  // as far as the file tells; by its name for files that tell no states
};

// A policy file, or the last policy of a run directory. Throws FileError or InvalidInput.
LoadedPolicy LoadPolicy(const std::string& path);

}  // namespace downpour
