// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <omp.h>

namespace downpour {

// Holds the calls of OpenBLAS (OpenMP build) that this thread makes to one thread, so that their
// bits are the same inside and outside of a parallel region. OpenBLAS asks omp_get_max_threads(),
// which belongs to the calling task: other threads see nothing of it.
class SingleThreadedBlas {
 public:
  SingleThreadedBlas() : threads_(omp_get_max_threads()) { omp_set_num_threads(1); }
  ~SingleThreadedBlas() { omp_set_num_threads(threads_); }
  SingleThreadedBlas(const SingleThreadedBlas&) = delete;
  SingleThreadedBlas& operator=(const SingleThreadedBlas&) = delete;

 private:
  int threads_;
};

}  // namespace downpour
