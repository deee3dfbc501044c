// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>

namespace downpour {

// Where data lie, nearest first.
enum MemoryLevel { kLevel2, kLevel3, kDram, kMemoryLevels };
inline constexpr std::array kMemoryLevelNames = {"L2", "L3", "DRAM"};

// Bytes of the data caches as the system tells them, a level 2 of each core; 0: unknown.
struct CacheSizes {
  std::size_t level1 = 0, level2 = 0, level3 = 0;
};
CacheSizes ReadCacheSizes();

// The nearest level that holds `bytes` of every thread: half of a cache, as other data pass through
// it, too, and as the third level is shared by `threads`.
MemoryLevel LevelOf(std::size_t bytes, const CacheSizes& caches, int threads);

// What the machine allows `threads` threads that run at once, all together.
struct Ceilings {
  int threads = 1;
  double fp64_gflops = 0, fp32_gflops = 0;  // fused multiply-adds, two operations each
  std::array<double, kMemoryLevels> gigabytes_per_second = {};  // read; 0: not measured
};

// GFLOP/s of the multiply-add peak of `threads` threads at once, in a tenth of a second.
double FmaPeakTogether(int threads, bool single_precision = false);

// GB/s that `threads` threads read at once, each `bytes` of its own, in a tenth of a second.
double ReadBandwidthTogether(int threads, std::size_t bytes);

// All of them, in about half a second. A level whose size is unknown, or of which the threads would
// need more than a quarter of the free memory, is not measured. Allocates what it reads.
Ceilings MeasureCeilings(int threads);

}  // namespace downpour
