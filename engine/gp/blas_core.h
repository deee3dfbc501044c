// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace downpour {

// OpenBLAS 0.3.21 does not know CPUs newer than itself and runs its SSE3 kernels ("Prescott") on
// them, six times slower than the AVX-512 ones. OPENBLAS_CORETYPE names the kernels to use, but is
// read while the library loads: a program can only mend the choice by starting itself again.

// Kernel family that OpenBLAS runs in this process, e.g. "SkylakeX". Thread-safe.
std::string BlasCoreName();

// Family that suits this CPU: "SkylakeX" (AVX-512), "Haswell" (AVX2 and FMA), or "" where any
// choice of OpenBLAS stands. Thread-safe.
std::string SuitableBlasCore();

// True if `core` uses narrower vectors than `suitable` does. Thread-safe.
bool IsWeakerBlasCore(const std::string& core, const std::string& suitable);

// True if MendBlasCore started this process again with a better family. Thread-safe.
bool BlasCoreWasMended();

// To be called first in main, before any thread starts. Where OpenBLAS chose a weaker family than
// the suitable one and the user has not set OPENBLAS_CORETYPE, sets it (and DOWNPOUR_BLAS_MENDED=1)
// and executes this program again with the same arguments; it does so once at most. Returns false
// if nothing was needed or the execution failed.
//
// Holds OpenBLAS at one thread, as all parallelism is outside of it. The OpenMP build of OpenBLAS
// does this through omp_set_num_threads(1): omp_get_max_threads() is 1 afterwards, so every
// parallel region names its number of threads.
bool MendBlasCore(char** argv);

}  // namespace downpour
