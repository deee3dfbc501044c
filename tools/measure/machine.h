// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace downpour {

// Model name as the system tells it; "unknown" if it does not.
std::string CpuModel();

// Name and version.
std::string Compiler();

// What measurements depend on, in order, by names that JSON can use: cpu, processors, cores,
// caches, simd, blas_core, compiler, flags, kernel, governor, ... What the system does not tell is
// "unknown".
std::vector<std::pair<std::string, std::string>> DescribeMachine();

// The instruction sets that the CPU reports, as one string.
std::string CpuFlags();

// Processes that want to run, mean of the last minute; negative: unknown.
double LoadAverage();

// One line if others keep the machine busy so that timings mislead; else empty.
std::string LoadWarning();

}  // namespace downpour
