// SPDX-License-Identifier: Apache-2.0
#include "engine/parallel_for.h"

#include <doctest/doctest.h>
#include <omp.h>

#include <string>
#include <vector>

#include "engine/errors.h"

namespace downpour {
namespace {

TEST_CASE("parallel_for: calls the body once for every index") {
  for (const int n : {0, 1, 3, 1000}) {
    for (const int threads : {1, 2, 5}) {
      std::vector<int> calls(n);
      ParallelFor(n, threads, [&](int i) { ++calls[i]; });
      CHECK(calls == std::vector<int>(n, 1));
    }
  }
}

TEST_CASE("parallel_for: a fixed assignment is the same in every region") {
  constexpr int kCalls = 8;
  for (const int threads : {1, 2, 5}) {
    std::vector<int> first(kCalls, -1), second(kCalls, -1);
    for (auto* by : {&first, &second}) {
      ParallelFor(
          kCalls, threads,
          [&](int i) {
            // The thread of call 0 is busy for longer than the others take for theirs.
            volatile double sum = 0;
            for (int k = 0; i == 0 && k < 1000000; ++k) sum = sum + k;
            (*by)[i] = omp_get_thread_num();
          },
          Assignment::kFixed);
    }
    CHECK(first == second);
    for (int i = 0; i < kCalls; ++i) CHECK(first[i] == i % threads);
  }
}

TEST_CASE("parallel_for: the caller gets the exception of the lowest index, after all others") {
  for (const int threads : {1, 3}) {
    std::vector<int> calls(100);
    std::string message;
    try {
      ParallelFor(100, threads, [&](int i) {
        ++calls[i];
        if (i % 7 == 5) throw InvalidInput(std::to_string(i));
      });
    } catch (const InvalidInput& error) {
      message = error.what();
    }
    CHECK(message == "5");
    CHECK(calls == std::vector<int>(100, 1));
  }
}

}  // namespace
}  // namespace downpour
