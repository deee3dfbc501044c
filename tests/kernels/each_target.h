// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "hwy/highway.h"

namespace downpour {

// Runs `check` once with dispatch held to each SIMD target that is compiled in and that this
// processor has.
template <typename Check>
void ForEachTarget(const Check& check) {
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(target);
    check(hwy::TargetName(target));
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().DeInit();
}

// A deterministic number in [-1, 1) for filling test data.
class TestNumbers {
 public:
  explicit TestNumbers(std::uint64_t seed) : state_(seed * 2862933555777941757u + 3037000493u) {}
  double operator()() {
    state_ = state_ * 6364136223846793005u + 1442695040888963407u;
    return static_cast<double>(static_cast<std::int64_t>(state_)) / 9223372036854775808.0;
  }

 private:
  std::uint64_t state_;
};

}  // namespace downpour
