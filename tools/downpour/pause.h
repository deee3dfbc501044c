// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <sched.h>

#include <chrono>
#include <thread>

namespace downpour {

// Waits between two looks for something that nobody wakes us for: not at all while it may come at
// any moment, longer the longer it has not.
class Pause {
 public:
  void Wait() {
    const auto waited = Clock::now() - start_;
    if (waited < std::chrono::milliseconds(1)) {
      sched_yield();
    } else {
      const bool long_ago = waited > std::chrono::seconds(1);
      std::this_thread::sleep_for(std::chrono::microseconds(long_ago ? 2000 : 50));
    }
  }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point start_ = Clock::now();
};

}  // namespace downpour
