// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace downpour {

// Sum of n doubles in vectors of the widest kind, eight partial sums of vectors, as fast as
// they can be read. `data` aligned. Thread-safe, does not allocate.
double SumOfDoubles(const double* data, std::size_t n);

// GB/s (10^9 bytes) at which one thread reads `n` doubles over and over, none of them written: the
// bandwidth of the first cache that holds them, or of the memory. Best of passes, or of groups of
// passes of 64 KiB or more, that fill `seconds`; one at least, and one before. n >= 1, `data`
// aligned. Thread-safe, does not allocate.
double ReadBandwidth(const double* data, std::size_t n, double seconds);

}  // namespace downpour
