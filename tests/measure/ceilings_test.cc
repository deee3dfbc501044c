// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/ceilings.h"

#include <doctest/doctest.h>

#include <string>

#include "tools/measure/machine.h"
#include "tools/measure/rollout_profile.h"

namespace downpour {
namespace {

TEST_CASE("ceilings: data lie in the nearest level that holds them twice") {
  const CacheSizes caches{32 << 10, 1 << 20, 16 << 20};
  CHECK(LevelOf(1 << 19, caches, 4) == kLevel2);
  CHECK(LevelOf((1 << 19) + 1, caches, 4) == kLevel3);
  CHECK(LevelOf(2 << 20, caches, 4) == kLevel3);
  CHECK(LevelOf((2 << 20) + 1, caches, 4) == kDram);
  CHECK(LevelOf(1, {}, 1) == kDram);  // sizes unknown
}

TEST_CASE("ceilings: rates of one thread and of two are possible") {
  const double one = ReadBandwidthTogether(1, 1 << 16), two = ReadBandwidthTogether(2, 1 << 16);
  CHECK(one > 0.1);
  CHECK(one < 2000);
  CHECK(two > 0.1);
  CHECK(two < 4000);
  CHECK(FmaPeakTogether(2, true) > FmaPeakTogether(1, false) / 4);
}

TEST_CASE("rollout_profile: the roof is the slower of arithmetic and reading") {
  Ceilings ceilings{.threads = 2, .fp64_gflops = 100, .fp32_gflops = 200};
  ceilings.gigabytes_per_second = {50, 10, 0};
  const Work work{.fp64_operations = 300, .fp32_operations = 400, .bytes = 40};
  // Half of the machine's rates for each thread.
  const Roof near = RoofOf(work, ceilings, kLevel2);
  CHECK(near.ns == doctest::Approx(2 * (3 + 2)));
  CHECK_FALSE(near.memory_bound);
  const Roof far = RoofOf({.fp64_operations = 100, .bytes = 400}, ceilings, kLevel3);
  CHECK(far.ns == doctest::Approx(80));
  CHECK(far.memory_bound);
  CHECK(RoofOf({.bytes = 400}, ceilings, kDram).ns == 0);  // not measured
}

TEST_CASE("machine: every entry says something") {
  for (const auto& entry : DescribeMachine()) {
    CAPTURE(entry.first);
    CHECK_FALSE(entry.second.empty());
  }
  CHECK(Compiler().find_first_of("0123456789") != std::string::npos);
}

}  // namespace
}  // namespace downpour
