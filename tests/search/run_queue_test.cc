// SPDX-License-Identifier: Apache-2.0
// How the runs of a round are shared out; that it changes no result is for policy_search_test.
#include "engine/search/run_queue.h"

#include <doctest/doctest.h>

#include <atomic>
#include <cstddef>
#include <vector>

#include "engine/parallel_for.h"
#include "engine/search/policy_search.h"
#include "engine/search/search_run.h"

namespace downpour {
namespace {

std::vector<SearchRun> MakeRuns(int n) {
  PolicySearchOptions options;
  options.bound = 5;
  std::vector<SearchRun> runs;
  for (int i = 0; i < n; ++i) {
    runs.emplace_back(options, RunPlan{i, Regime::kSmall, 4, 1.0}, std::vector<double>(3, 0.0), 1,
                      1);
  }
  return runs;
}

using Share = std::vector<SearchRun*>;

TEST_CASE("run_queue: shares differ by one run at most, and no thread goes without") {
  for (int n_threads = 1; n_threads <= 9; ++n_threads) {
    std::vector<SearchRun> runs = MakeRuns(9);
    RunQueue queue(runs, 1);
    std::vector<int> taken(9, 0);
    for (int t = 0; t < n_threads; ++t) {
      Share share;
      REQUIRE(queue.TakeShare(n_threads, &share));
      CHECK(std::ssize(share) >= 9 / n_threads);
      CHECK(std::ssize(share) <= (9 + n_threads - 1) / n_threads);
      for (const SearchRun* run : share) ++taken[static_cast<std::size_t>(run - runs.data())];
    }
    CHECK(taken == std::vector<int>(9, 1));
  }
}

TEST_CASE("run_queue: who is ahead takes runs over, and the last run is nobody's share") {
  std::vector<SearchRun> runs = MakeRuns(4);
  RunQueue queue(runs, 2);
  Share slow, fast;
  REQUIRE(queue.TakeShare(2, &slow));
  CHECK(slow.size() == 2);
  for (int generation = 0; generation < 2; ++generation) {
    REQUIRE(queue.TakeShare(2, &fast));
    CHECK(fast.size() == 2);
    CHECK(fast[0] != slow[0]);
    queue.Return(fast);
  }
  // Its own two are done. Of the two that come back once it takes one for their second generation.
  queue.Return(slow);
  REQUIRE(queue.TakeShare(2, &fast));
  CHECK(fast.size() == 1);
  REQUIRE(queue.TakeShare(2, &slow));
  CHECK(slow.size() == 1);
  CHECK(slow[0] != fast[0]);
  queue.Return(fast);
  // One run goes on, the slow thread has it: no more shares for either.
  CHECK(!queue.TakeShare(2, &fast));
  CHECK(fast.empty());
  queue.Return(slow);
  CHECK(!queue.TakeShare(2, &slow));
  CHECK(!queue.TakeAll(&slow));  // that was its last generation
}

TEST_CASE("run_queue: what goes on after the shares is taken together") {
  std::vector<SearchRun> runs = MakeRuns(2);
  RunQueue queue(runs, 3);
  Share slow, fast, all;
  REQUIRE(queue.TakeShare(2, &slow));
  for (int generation = 0; generation < 3; ++generation) {
    REQUIRE(queue.TakeShare(2, &fast));
    queue.Return(fast);
  }
  CHECK(!queue.TakeShare(2, &fast));
  queue.Return(slow);
  CHECK(!queue.TakeShare(2, &slow));
  for (int generation = 1; generation < 3; ++generation) {
    REQUIRE(queue.TakeAll(&all));
    CHECK(all.size() == 1);
    queue.Return(all);
  }
  CHECK(!queue.TakeAll(&all));
}

TEST_CASE("run_queue: threads that wait get what others return, until all is done") {
  constexpr int kRuns = 7, kGenerations = 50;
  for (const int n_threads : {2, 3, 5, 7}) {
    std::vector<SearchRun> runs = MakeRuns(kRuns);
    RunQueue queue(runs, kGenerations);
    std::vector<std::atomic<int>> generations(kRuns), holders(kRuns);
    std::atomic<bool> shared = false;
    std::atomic<double> sum = 0;
    const auto work = [&](const Share& share, int length) {
      for (const SearchRun* run : share) {
        const auto i = static_cast<std::size_t>(run - runs.data());
        if (++holders[i] > 1) shared = true;
        ++generations[i];
        // Some take longer than others.
        double value = 1;
        for (int k = 0; k < length; ++k) value = value * 0.999 + 0.001;
        sum = sum + value;
        --holders[i];
      }
    };
    const auto thread = [&](int t) {
      Share share;
      while (queue.TakeShare(n_threads, &share)) {
        work(share, 2000 * t);
        queue.Return(share);
      }
    };
    ParallelFor(n_threads, n_threads, thread, Assignment::kFixed);
    int together = 0;
    Share share;
    for (; queue.TakeAll(&share); ++together) {
      CHECK(2 * std::ssize(share) <= n_threads);
      work(share, 0);
      queue.Return(share);
    }
    CHECK(together < kGenerations);
    CHECK(!shared);
    for (const std::atomic<int>& n : generations) CHECK(n == kGenerations);
  }
}

TEST_CASE("run_queue: nothing goes on when it is abandoned") {
  std::vector<SearchRun> runs = MakeRuns(3);
  RunQueue queue(runs, 3);
  Share one, other;
  REQUIRE(queue.TakeShare(2, &one));
  queue.Abandon();
  CHECK(!queue.TakeShare(2, &other));
  CHECK(!queue.TakeAll(&other));
}

}  // namespace
}  // namespace downpour
