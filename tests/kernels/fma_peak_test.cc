// SPDX-License-Identifier: Apache-2.0
#include "kernels/fma_peak/fma_peak.h"

#include <doctest/doctest.h>

#include <string>

#include "hwy/targets.h"

namespace downpour {
namespace {

// Under the address sanitizer every operation is a call: 0.2 GFLOP/s were seen on a busy machine.
#ifdef __SANITIZE_ADDRESS__
constexpr double kLeastGflops = 0.02;
#else
constexpr double kLeastGflops = 0.5;
#endif

TEST_CASE("fma_peak: rates are possible for one core") {
  const double fp64 = FmaPeakGflops(false, 0.05);
  const double fp32 = FmaPeakGflops(true, 0.05);
  CAPTURE(fp64);
  CAPTURE(fp32);
  CHECK(fp64 > kLeastGflops);
  CHECK(fp64 < 500);  // 2 pipes x 8 lanes x 2 operations x 15 GHz
  CHECK(fp32 > kLeastGflops);
  CHECK(fp32 < 1000);
}

TEST_CASE("fma_peak: the SIMD target is one that this CPU supports") {
  const std::string name = SimdTargetName();
  bool supported = false;
  for (int bit = 0; bit < 63; ++bit) {
    const auto target = hwy::SupportedTargets() & (1LL << bit);
    supported = supported || (target != 0 && name == hwy::TargetName(target));
  }
  CHECK_MESSAGE(supported, name);
  const int lanes = name.starts_with("AVX3") ? 16 : name == "AVX2" ? 8 : 4;
  CHECK(SimdFloatLanes() == lanes);
}

}  // namespace
}  // namespace downpour
