// SPDX-License-Identifier: Apache-2.0
#include "bench/program.h"

#include <cstdio>
#include <exception>

#include "engine/gp/process_settings.h"

namespace downpour {

int RunProgram(const char* name, int (*body)(int argc, char** argv), int argc, char** argv) {
  PrepareProcess(argv);
  try {
    return body(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", name, error.what());
    return 2;
  }
}

}  // namespace downpour
