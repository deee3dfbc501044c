// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>

namespace downpour {

// From now on the first Ctrl-C (SIGINT) or SIGTERM asks for a clean end, and a second one ends the
// process at once.
void InstallStopHandler();

// True once an end was asked for.
const std::atomic<bool>& StopRequested();

// By which signal; 0 before.
int StopSignal();

}  // namespace downpour
