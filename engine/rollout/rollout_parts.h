// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <chrono>
#include <cstdint>

namespace downpour {

// What a rollout's time goes into.
enum RolloutPart {
  kPartPacking,  // parameters, keys and start states into the tile, returns out of it
  kPartPolicy,
  kPartQueries,   // means and variances of all outputs
  kPartPrior,     // the prior mean of the dynamics, if there is one
  kPartSampling,  // normal numbers
  kPartTransition,
  kPartFeatures,
  kPartReward,
  kRolloutParts
};

// Seconds of each part, all threads together, and how often the clock was read for it: what the
// clock itself takes is in them.
struct PartTimes {
  std::array<double, kRolloutParts> seconds = {};
  std::array<std::int64_t, kRolloutParts> readings = {};

  PartTimes& operator+=(const PartTimes& other) {
    for (int part = 0; part < kRolloutParts; ++part) {
      seconds[part] += other.seconds[part];
      readings[part] += other.readings[part];
    }
    return *this;
  }
  PartTimes& operator-=(const PartTimes& other) {
    for (int part = 0; part < kRolloutParts; ++part) {
      seconds[part] -= other.seconds[part];
      readings[part] -= other.readings[part];
    }
    return *this;
  }
};

// Hands the time since its last call to a part; does nothing without `times`.
class PartClock {
 public:
  explicit PartClock(PartTimes* times) : times_(times) {
    if (times_ != nullptr) last_ = Clock::now();
  }
  void Charge(RolloutPart part) {
    if (times_ == nullptr) return;
    const Clock::time_point now = Clock::now();
    times_->seconds[part] += std::chrono::duration<double>(now - last_).count();
    ++times_->readings[part];
    last_ = now;
  }

 private:
  using Clock = std::chrono::steady_clock;
  PartTimes* times_;
  Clock::time_point last_ = {};
};

}  // namespace downpour
