// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <exception>
#include <vector>

#include "engine/spin_end.h"

namespace downpour {

// kDynamic: to the threads that are free. kFixed: call i is made by the same thread in every region
// of as many calls and threads, whose caches hold what it left there.
enum class Assignment { kDynamic, kFixed };

// Calls body(i) for every i in [0, n) on `threads` >= 1 OpenMP threads, in any order. An exception
// must not leave an OpenMP region: when all calls are done, that of the lowest i is rethrown.
// Allocates an entry a call, before the region.
template <typename Body>
void ParallelFor(int n, int threads, const Body& body,
                 Assignment assignment = Assignment::kDynamic) {
  std::vector<std::exception_ptr> errors(static_cast<std::size_t>(n));
  const auto call = [&](int i) {
    try {
      body(i);
    } catch (...) {
      errors[static_cast<std::size_t>(i)] = std::current_exception();
    }
  };
  const int team = n > 1 ? threads : 1;
  SpinEnd region_end;
#pragma omp parallel num_threads(team)
  {
    if (assignment == Assignment::kFixed) {
#pragma omp for schedule(static, 1) nowait
      for (int i = 0; i < n; ++i) call(i);
    } else {
#pragma omp for schedule(dynamic) nowait
      for (int i = 0; i < n; ++i) call(i);
    }
    region_end.Arrive();
  }
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }
}

// Calls body(i), which must not throw, for every i in [0, n), one at a time to the threads that are
// free. Returns the seconds that they took until none was left, all threads together. Does not
// allocate.
template <typename Body>
double TimedParallelFor(int n, int threads, const Body& body) {
  double busy = 0;
  SpinEnd region_end;
#pragma omp parallel num_threads(threads) reduction(+ : busy)
  {
    const auto start = std::chrono::steady_clock::now();
#pragma omp for schedule(dynamic, 1) nowait
    for (int i = 0; i < n; ++i) body(i);
    busy += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    region_end.Arrive();
  }
  return busy;
}

}  // namespace downpour
