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
  RunQueue(std::span<SearchRun> runs, int generations);

  // For one generation, a fair share among `n_threads`, the same in every call, that have one share
  // each at most: those of the free runs which have the most generations before them. Waits if
  // others have them all. False when a thread is left without and at most half as many runs go on
  // as there are threads: then none gets more, and those runs are for all threads together
  // (TakeAll).
  bool TakeShare(int n_threads, std::vector<SearchRun*>* taken);
  // For one generation, all runs that go on, none of which is taken; false when none does.
  bool TakeAll(std::vector<SearchRun*>* taken);
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

  void Take(Entry* entry, std::vector<SearchRun*>* taken);

  std::mutex mutex_;
  std::condition_variable returned_;
  std::vector<Entry> entries_;  // of the runs that go on
  int n_shares_ = 0;            // that threads have now
  bool shares_end_ = false;
};

}  // namespace downpour
