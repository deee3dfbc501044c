// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "engine/learner/learner.h"

namespace downpour {

// That of this process. Thread-safe.
Platform CurrentPlatform();

// One line that says why `state` and what `current` adds to it are not together the bits of an
// uninterrupted run; "" if they are. It names the first episode of another platform.
std::string PlatformDifference(const LearnerState& state, const Platform& current);

}  // namespace downpour
