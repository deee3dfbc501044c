// SPDX-License-Identifier: Apache-2.0
#include "kernels/bandwidth/bandwidth.h"

#include <algorithm>
#include <chrono>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/bandwidth/bandwidth.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Two loads a cycle times an addition's latency of four need eight sums.
double Sum(const double* HWY_RESTRICT data, std::size_t n) {
  constexpr std::size_t kSums = 8;
  const hn::ScalableTag<double> d;
  const std::size_t lanes = hn::Lanes(d);
  hn::Vec<decltype(d)> sums[kSums];
  for (auto& sum : sums) sum = hn::Zero(d);
  std::size_t i = 0;
  for (; i + kSums * lanes <= n; i += kSums * lanes) {
    HWY_UNROLL(8) for (std::size_t k = 0; k < kSums; ++k) {
      sums[k] = hn::Add(sums[k], hn::Load(d, data + i + k * lanes));
    }
  }
  for (std::size_t k = 1; k < kSums; ++k) sums[0] = hn::Add(sums[0], sums[k]);
  double total = hn::GetLane(hn::SumOfLanes(d, sums[0]));
  for (; i < n; ++i) total += data[i];
  return total;
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Sum);

double SumOfDoubles(const double* data, std::size_t n) {
  return HWY_DYNAMIC_DISPATCH(Sum)(data, n);
}

double ReadBandwidth(const double* data, std::size_t n, double seconds) {
  using Clock = std::chrono::steady_clock;
  // A reading of the clock is small beside 64 KiB or more.
  const int passes = static_cast<int>(8192 / n) + 1;
  double best = 0, elapsed = 0;
  volatile double consumed = SumOfDoubles(data, n);  // fills the caches and chooses the target
  const auto sum = HWY_DYNAMIC_DISPATCH(Sum);
  do {
    const auto begin = Clock::now();
    for (int pass = 0; pass < passes; ++pass) consumed = sum(data, n);
    const double time = std::chrono::duration<double>(Clock::now() - begin).count();
    best = std::max(best, 1e-9 * sizeof(double) * static_cast<double>(n) * passes / time);
    elapsed += time;
  } while (elapsed < seconds);
  static_cast<void>(consumed);
  return best;
}

}  // namespace downpour
#endif  // HWY_ONCE
