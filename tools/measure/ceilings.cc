// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/ceilings.h"

#include <omp.h>
#include <unistd.h>

#include <algorithm>

#include "kernels/aligned.h"
#include "kernels/bandwidth/bandwidth.h"
#include "kernels/fma_peak/fma_peak.h"

namespace downpour {
namespace {

// Sum of the rates that `measure`, a hundredth of a second, gives the threads. All stay busy until
// the first one is done, and what each reached while alone does not count. `prepare` comes before.
template <typename Prepare, typename Measure>
double RateTogether(int threads, const Prepare& prepare, const Measure& measure) {
  constexpr int kRounds = 10;
  double sum = 0;
  bool done = false;
#pragma omp parallel num_threads(threads) reduction(+ : sum)
  {
    const auto prepared = prepare();
    double total = 0, last = 0;
    int rounds = 0;
#pragma omp barrier
    for (bool go_on = true; go_on;) {
      last = measure(prepared);
      total += last;
      ++rounds;
      if (omp_get_thread_num() == 0 && rounds == kRounds) {
#pragma omp atomic write
        done = true;
      }
#pragma omp atomic read
      go_on = done;
      go_on = !go_on;
    }
    sum +=
        omp_get_thread_num() == 0 || rounds == 1 ? total / rounds : (total - last) / (rounds - 1);
  }
  return sum;
}

std::size_t CacheSize(int name) {
  const long bytes = sysconf(name);
  return bytes > 0 ? static_cast<std::size_t>(bytes) : 0;
}

// Bytes a thread reads to show the bandwidth of a level: clear of the nearer ones.
std::size_t TestSize(MemoryLevel level, const CacheSizes& caches, int threads) {
  switch (level) {
    case kLevel2:
      return caches.level2 / 2;
    case kLevel3:
      return std::min(4 * caches.level2, caches.level3 / 2 / threads);
    default:
      return 2 * std::max(caches.level2, caches.level3) / threads;
  }
}

}  // namespace

CacheSizes ReadCacheSizes() {
  return {CacheSize(_SC_LEVEL1_DCACHE_SIZE), CacheSize(_SC_LEVEL2_CACHE_SIZE),
          CacheSize(_SC_LEVEL3_CACHE_SIZE)};
}

MemoryLevel LevelOf(std::size_t bytes, const CacheSizes& caches, int threads) {
  if (bytes <= caches.level2 / 2) return kLevel2;
  return bytes * threads <= caches.level3 / 2 ? kLevel3 : kDram;
}

double FmaPeakTogether(int threads, bool single_precision) {
  return RateTogether(
      threads, [] { return 0; }, [&](int) { return FmaPeakGflops(single_precision, 0.01); });
}

double ReadBandwidthTogether(int threads, std::size_t bytes) {
  const std::size_t n = std::max<std::size_t>(1, bytes / sizeof(double));
  return RateTogether(
      threads, [&] { return AlignedVector<double>(n, 1.0); },
      [&](const AlignedVector<double>& data) { return ReadBandwidth(data.data(), n, 0.01); });
}

Ceilings MeasureCeilings(int threads) {
  Ceilings ceilings{.threads = threads};
  ceilings.fp64_gflops = FmaPeakTogether(threads, false);
  ceilings.fp32_gflops = FmaPeakTogether(threads, true);
  const CacheSizes caches = ReadCacheSizes();
  const double free_bytes =
      static_cast<double>(sysconf(_SC_AVPHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
  for (const MemoryLevel level : {kLevel2, kLevel3, kDram}) {
    const std::size_t bytes = TestSize(level, caches, threads);
    if (bytes == 0 || static_cast<double>(bytes) * threads > free_bytes / 4) continue;
    ceilings.gigabytes_per_second[level] = ReadBandwidthTogether(threads, bytes);
  }
  return ceilings;
}

}  // namespace downpour
