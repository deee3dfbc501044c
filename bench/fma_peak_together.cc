// SPDX-License-Identifier: Apache-2.0
#include "bench/fma_peak_together.h"

#include <omp.h>

#include "kernels/fma_peak/fma_peak.h"

namespace downpour {

// All stay busy until the first one is done, and what each reached while alone does not count.
double FmaPeakTogether(int threads) {
  constexpr int kRounds = 10;
  double sum = 0;
  bool done = false;
#pragma omp parallel num_threads(threads) reduction(+ : sum)
  {
    double total = 0, last = 0;
    int rounds = 0;
    for (bool go_on = true; go_on;) {
      last = FmaPeakGflops(false, 0.01);
      total += last;
      ++rounds;
      if (omp_get_thread_num() == 0 && rounds == kRounds) {
#pragma omp atomic write
        done = true;
      }
#pragma omp atomic read
      go_on = done;
      go_on = !go_on;
    }
    sum +=
        omp_get_thread_num() == 0 || rounds == 1 ? total / rounds : (total - last) / (rounds - 1);
  }
  return sum;
}

}  // namespace downpour
