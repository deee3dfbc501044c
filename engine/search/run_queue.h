// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <condition_variable>
#include <mutex>
#include <span>
#include <vector>

#include "engine/search/search_run.h"

namespace downpour {

// Hands the runs of a search out to threads, generation by generation, until each has had so many
// or has met a stopping criterion. No run depends on another, so who takes which and when changes
// nothing. All members are thread-safe.
class RunQueue {
 public:
  // generations >= 1.
  RunQueue(std::span<SearchRun> runs, int generations, int n_threads);

  // Takes a thread's share of the runs that go on, those which have the most generations before
  // them, for one generation. Waits if others have them all; false when none goes on.
  bool Take(std::vector<SearchRun*>* taken);
  // After that generation.
  void Return(std::span<SearchRun* const> taken);
  // No run goes on. What was taken need not be returned.
  void Abandon();

 private:
  struct Entry {
    SearchRun* run;
    int left;  // generations
    bool taken;
  };

  int n_threads_;
  std::mutex mutex_;
  std::condition_variable returned_;
  std::vector<Entry> entries_;  // of the runs that go on
};

}  // namespace downpour
