// SPDX-License-Identifier: Apache-2.0
#define DOCTEST_CONFIG_IMPLEMENT
#include <doctest/doctest.h>

#include "engine/gp/process_settings.h"

int main(int argc, char** argv) {
  downpour::PrepareProcess(argv);
  return doctest::Context(argc, argv).run();
}
