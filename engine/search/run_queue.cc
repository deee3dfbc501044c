// SPDX-License-Identifier: Apache-2.0
#include "engine/search/run_queue.h"

#include <algorithm>
#include <cstddef>

namespace downpour {

RunQueue::RunQueue(std::span<SearchRun> runs, int generations) {
  for (SearchRun& run : runs) entries_.push_back({&run, generations, false});
}

void RunQueue::Take(Entry* entry, std::vector<SearchRun*>* taken) {
  entry->taken = true;
  taken->push_back(entry->run);
}

bool RunQueue::TakeShare(int n_threads, std::vector<SearchRun*>* taken) {
  taken->clear();
  std::unique_lock lock(mutex_);
  const auto n_free = [&] {
    return static_cast<int>(std::count_if(entries_.begin(), entries_.end(),
                                          [](const Entry& entry) { return !entry.taken; }));
  };
  returned_.wait(lock, [&] {
    if (n_free() == 0 && 2 * std::ssize(entries_) <= n_threads) shares_end_ = true;
    return shares_end_ || n_free() > 0;
  });
  if (shares_end_) return false;
  // While a thread works on its runs they are no one else's; only towards the end, as the faster
  // threads have none left, shares become smaller and runs change hands.
  const int without = n_threads - n_shares_;
  int share = (n_free() + without - 1) / without;
  std::stable_sort(entries_.begin(), entries_.end(),
                   [](const Entry& a, const Entry& b) { return a.left > b.left; });
  for (Entry& entry : entries_) {
    if (entry.taken || share == 0) continue;
    Take(&entry, taken);
    --share;
  }
  ++n_shares_;
  return true;
}

bool RunQueue::TakeAll(std::vector<SearchRun*>* taken) {
  taken->clear();
  const std::scoped_lock lock(mutex_);
  if (entries_.empty()) return false;
  for (Entry& entry : entries_) Take(&entry, taken);
  ++n_shares_;
  return true;
}

void RunQueue::Return(std::span<SearchRun* const> taken) {
  {
    const std::scoped_lock lock(mutex_);
    for (Entry& entry : entries_) {
      if (std::find(taken.begin(), taken.end(), entry.run) == taken.end()) continue;
      entry.taken = false;
      --entry.left;
    }
    std::erase_if(entries_, [](const Entry& entry) {
      return !entry.taken && (entry.left == 0 || !entry.run->stop().empty());
    });
    --n_shares_;
  }
  returned_.notify_all();
}

void RunQueue::Abandon() {
  {
    const std::scoped_lock lock(mutex_);
    entries_.clear();
    shares_end_ = true;
  }
  returned_.notify_all();
}

}  // namespace downpour
