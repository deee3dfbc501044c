// SPDX-License-Identifier: Apache-2.0
// Stands in for mpi_world.cc where MPI was not there to build with.
#include <fmt/format.h>

#include "engine/errors.h"
#include "tools/downpour/mpi_launch.h"
#include "tools/downpour/mpi_world.h"

namespace downpour {

MpiWorld::MpiWorld(const char* command) {
  const int processes = LaunchedProcesses();
  if (processes == 1) return;
  throw InvalidInput(
      fmt::format("{} was started {} times by mpirun, but built without MPI: start it once, or "
                  "install libopenmpi-dev and build again",
                  command, processes));
}

MpiWorld::~MpiWorld() = default;
void MpiWorld::Send(int, std::string) {}
std::optional<MpiMessage> MpiWorld::Poll() { return std::nullopt; }
void MpiWorld::GiveUp(int) {}

bool TellsCommandLineErrors() { return LaunchedRank() == 0; }

}  // namespace downpour
