// SPDX-License-Identifier: Apache-2.0
#include "kernels/fma_peak/fma_peak.h"

#include <algorithm>
#include <chrono>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/fma_peak/fma_peak.cc"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// x <- x / 2 + 1/2 on every lane of 12 independent chains: two pipes times a latency of at most 5
// cycles need 10, and 16 registers hold 12 and the two operands. The fixed point is 1, so values
// stay normal; starts differ, so that no two chains can be merged. Adds what depends on every
// operation to `sink` and returns the number of operations.
template <typename T>
double RunChains(long steps, double start, double& sink) {
  const hn::ScalableTag<T> d;
  const auto half = hn::Set(d, T(0.5));
  const auto chain = [&](int i) { return hn::Iota(d, static_cast<T>(start + i)); };
  auto x0 = chain(0), x1 = chain(1), x2 = chain(2), x3 = chain(3), x4 = chain(4), x5 = chain(5);
  auto x6 = chain(6), x7 = chain(7), x8 = chain(8), x9 = chain(9), x10 = chain(10), x11 = chain(11);
  for (long i = 0; i < steps; ++i) {
    x0 = hn::MulAdd(x0, half, half);
    x1 = hn::MulAdd(x1, half, half);
    x2 = hn::MulAdd(x2, half, half);
    x3 = hn::MulAdd(x3, half, half);
    x4 = hn::MulAdd(x4, half, half);
    x5 = hn::MulAdd(x5, half, half);
    x6 = hn::MulAdd(x6, half, half);
    x7 = hn::MulAdd(x7, half, half);
    x8 = hn::MulAdd(x8, half, half);
    x9 = hn::MulAdd(x9, half, half);
    x10 = hn::MulAdd(x10, half, half);
    x11 = hn::MulAdd(x11, half, half);
  }
  const auto sum = hn::Add(hn::Add(hn::Add(x0, x1), hn::Add(x2, x3)),
                           hn::Add(hn::Add(hn::Add(x4, x5), hn::Add(x6, x7)),
                                   hn::Add(hn::Add(x8, x9), hn::Add(x10, x11))));
  sink += static_cast<double>(hn::GetLane(hn::SumOfLanes(d, sum)));
  return 2.0 * 12 * static_cast<double>(hn::Lanes(d)) * static_cast<double>(steps);
}

double RunSingle(long steps, double start, double& sink) {
  return RunChains<float>(steps, start, sink);
}
double RunDouble(long steps, double start, double& sink) {
  return RunChains<double>(steps, start, sink);
}
const char* TargetName() { return hwy::TargetName(HWY_TARGET); }
int FloatLanes() { return static_cast<int>(hn::Lanes(hn::ScalableTag<float>())); }

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(RunSingle);
HWY_EXPORT(RunDouble);
HWY_EXPORT(TargetName);
HWY_EXPORT(FloatLanes);

double FmaPeakGflops(bool single_precision, double seconds) {
  using Clock = std::chrono::steady_clock;
  const auto run =
      single_precision ? HWY_DYNAMIC_DISPATCH(RunSingle) : HWY_DYNAMIC_DISPATCH(RunDouble);
  constexpr long kSteps = 200000;  // about a millisecond
  double sink = 0, best = 0, elapsed = 0;
  do {
    const auto begin = Clock::now();
    const double operations = run(kSteps, sink, sink);
    const double time = std::chrono::duration<double>(Clock::now() - begin).count();
    best = std::max(best, operations / time);
    elapsed += time;
  } while (elapsed < seconds);
  volatile double consumed = sink;
  static_cast<void>(consumed);
  return best * 1e-9;
}

const char* SimdTargetName() { return HWY_DYNAMIC_DISPATCH(TargetName)(); }

int SimdFloatLanes() { return HWY_DYNAMIC_DISPATCH(FloatLanes)(); }

}  // namespace downpour
#endif  // HWY_ONCE
