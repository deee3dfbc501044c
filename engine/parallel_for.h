// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <exception>
#include <vector>

namespace downpour {

// Calls body(i) for every i in [0, n) on `threads` >= 1 OpenMP threads, in any order. An exception
// must not leave an OpenMP region: when all calls are done, that of the lowest i is rethrown.
// Allocates an entry a call, before the region.
template <typename Body>
void ParallelFor(int n, int threads, const Body& body) {
  std::vector<std::exception_ptr> errors(static_cast<std::size_t>(n));
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (int i = 0; i < n; ++i) {
    try {
      body(i);
    } catch (...) {
      errors[static_cast<std::size_t>(i)] = std::current_exception();
    }
  }
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }
}

}  // namespace downpour
