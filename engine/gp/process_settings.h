// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace downpour {

// Settings that OpenBLAS and the OpenMP runtime read from the environment while they load, so that
// a program can mend them only by starting itself again:
// - OpenBLAS 0.3.21 does not know CPUs newer than itself and runs its SSE3 kernels ("Prescott") on
//   them, six times slower than the AVX-512 ones. OPENBLAS_CORETYPE names the kernels to use.
// - OpenMP threads that wait spin for long, and so keep a core from the thread they wait for when
//   the machine has other work; those that sleep at once (OMP_WAIT_POLICY=passive) take 50 us to
//   wake, a tenth of a generation's time. GOMP_SPINCOUNT=2000, some 0.1 ms, lets them spin between
//   the regions of a generation and no longer; where regions end see SpinEnd. ns a query of a
//   search, two threads alone: passive 89, 2000 spins 81, 20000 spins 79; four threads on four
//   cores with three other processes: 180, 153-194, 392, and 1109 with the default of 300000.

// Kernel family that OpenBLAS runs in this process, e.g. "SkylakeX". Thread-safe.
std::string BlasCoreName();

// Family that suits this CPU: "SkylakeX" (AVX-512), "Haswell" (AVX2 and FMA), or "" where any
// choice of OpenBLAS stands. Thread-safe.
std::string SuitableBlasCore();

// True if `core` uses narrower vectors than `suitable` does. Thread-safe.
bool IsWeakerBlasCore(const std::string& core, const std::string& suitable);

// True if PrepareProcess started this process again with a better family. Thread-safe.
bool BlasCoreWasMended();

// To be called first in main, before any thread starts. Where OpenBLAS chose a weaker family than
// the suitable one, sets OPENBLAS_CORETYPE (and DOWNPOUR_BLAS_MENDED=1), and sets
// OMP_WAIT_POLICY=passive and GOMP_SPINCOUNT unless either is set already; variables that the user
// has set stay. If it set any, executes this program again with the same arguments, once at most.
// Returns false if nothing was needed or the execution failed.
//
// Holds OpenBLAS at one thread, as all parallelism is outside of it. The OpenMP build of OpenBLAS
// does this through omp_set_num_threads(1): omp_get_max_threads() is 1 afterwards, so every
// parallel region names its number of threads.
bool PrepareProcess(char** argv);

}  // namespace downpour
