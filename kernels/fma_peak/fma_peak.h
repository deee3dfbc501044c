// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace downpour {

// Fused multiply-adds that one thread reaches on registers alone, in GFLOP/s (two operations each):
// the ceiling beside which other kernels' rates are read. Best of repetitions of about one
// millisecond that fill `seconds`, as neighbours on a shared machine only ever slow one down.
// Thread-safe, does not allocate.
double FmaPeakGflops(bool single_precision, double seconds);

// Instruction set that Highway dispatches to on this CPU, e.g. "AVX3". Thread-safe.
const char* SimdTargetName();
// Floats in a vector of that instruction set, e.g. 16. Thread-safe.
int SimdFloatLanes();

}  // namespace downpour
