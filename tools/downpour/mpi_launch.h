// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>

namespace downpour {

// The variables by which launchers tell a process how many there are and which of them it is: Open
// MPI's mpirun, and those that speak PMI (MPICH, Slurm).
inline constexpr const char* kSizeVariables[] = {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"};
inline constexpr const char* kRankVariables[] = {"OMPI_COMM_WORLD_RANK", "PMI_RANK"};

// Processes that were started with this one, itself included.
inline int LaunchedProcesses() {
  for (const char* name : kSizeVariables) {
    if (const char* text = std::getenv(name)) return std::atoi(text);
  }
  return 1;
}

inline int LaunchedRank() {
  for (const char* name : kRankVariables) {
    if (const char* text = std::getenv(name)) return std::atoi(text);
  }
  return 0;
}

}  // namespace downpour
