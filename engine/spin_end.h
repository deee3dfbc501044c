// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <omp.h>

#include <atomic>
#include <chrono>

namespace downpour {

// The end of a parallel region whose threads are soon needed again. OpenMP's own waiting sleeps
// after 0.1 ms (engine/gp/process_settings.h), and threads that fall asleep cost a search a tenth
// of its time; but one that spins for longer keeps its core from other processes, and so from the
// thread it waits for. So a thread spins for up to kPatience, and when that was in vain, as where
// the machine has other work, not at the next kRest regions where it has to wait.
class SpinEnd {
 public:
  // Called once by every thread of the region, as the last thing in it. Does not allocate.
  void Arrive() {
    using Clock = std::chrono::steady_clock;
    const int all = omp_get_num_threads();
    const auto all_arrived = [&] { return arrived_.load(std::memory_order_acquire) == all; };
    arrived_.fetch_add(1, std::memory_order_release);
    if (all_arrived()) return;
    thread_local int rest = 0;
    if (rest > 0) {
      --rest;
      return;
    }
    const Clock::time_point end = Clock::now() + kPatience;
    while (Clock::now() < end) {
      if (all_arrived()) return;
#ifdef __x86_64__
      __builtin_ia32_pause();  // leaves the core to its other thread
#endif
    }
    rest = kRest;
  }

 private:
  static constexpr std::chrono::milliseconds kPatience{1};
  static constexpr int kRest = 64;

  std::atomic<int> arrived_ = 0;
};

}  // namespace downpour
