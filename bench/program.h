// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace downpour {

// Runs `body` in a prepared process (engine/gp/process_settings.h). An exception becomes one line,
// "name: what", on stderr and exit status 2.
int RunProgram(const char* name, int (*body)(int argc, char** argv), int argc, char** argv);

}  // namespace downpour
