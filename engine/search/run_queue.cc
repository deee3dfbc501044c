// SPDX-License-Identifier: Apache-2.0
#include "engine/search/run_queue.h"

#include <algorithm>
#include <cstddef>

namespace downpour {

RunQueue::RunQueue(std::span<SearchRun> runs, int generations, int n_threads)
    : n_threads_(n_threads) {
  for (SearchRun& run : runs) entries_.push_back({&run, generations, false});
}

bool RunQueue::Take(std::vector<SearchRun*>* taken) {
  taken->clear();
  std::unique_lock lock(mutex_);
  const auto is_free = [](const Entry& entry) { return !entry.taken; };
  returned_.wait(lock, [&] {
    return entries_.empty() || std::any_of(entries_.begin(), entries_.end(), is_free);
  });
  // While a thread works on its runs they are no one else's; only towards the end, as the faster
  // threads have none left, shares become smaller and runs change hands.
  const std::size_t share = (entries_.size() + n_threads_ - 1) / n_threads_;
  std::stable_sort(entries_.begin(), entries_.end(),
                   [](const Entry& a, const Entry& b) { return a.left > b.left; });
  for (Entry& entry : entries_) {
    if (entry.taken || taken->size() == share) continue;
    entry.taken = true;
    taken->push_back(entry.run);
  }
  return !taken->empty();
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
  }
  returned_.notify_all();
}

void RunQueue::Abandon() {
  {
    const std::scoped_lock lock(mutex_);
    entries_.clear();
  }
  returned_.notify_all();
}

}  // namespace downpour
