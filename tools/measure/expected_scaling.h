// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <string>
#include <vector>

namespace downpour {

// What a search evaluates at once: a generation of all its runs, or a comparison, which all threads
// share as if it were one run.
struct GenerationLanes {
  int runs = 1;   // > 0, taken for equally large
  int lanes = 0;  // rollouts of all of them, > 0
};

// What the speed-up of a search is expected from, all measured.
struct ScalingBasis {
  double seconds = 0;         // a search by one thread
  double serial_seconds = 0;  // of it, what more threads do not shorten
  std::vector<GenerationLanes> generations;
  int tile_unit = 16;            // lanes of which tiles hold multiples: TileUnit
  std::vector<double> fma_gain;  // [t - 1]: FMA peak of t threads over that of one
  // GB/s that t threads read where the factors are, and what one thread of the search reads.
  std::vector<double> gigabytes_per_second;
  double demand = 0;
  bool shared_memory = false;  // L3 or DRAM, which more cores do not widen
};

struct ExpectedSpeedUp {
  int threads = 1;
  double speed_up = 1;
  // What holds the rollouts back: "FMA" (threads share cores), "tiles" (a generation has too few
  // runs and whole vectors of lanes), "bandwidth".
  std::string bound;
};

// Amdahl's law with the parallel part held back by the least of three gains. Cores beyond the
// measured ones are taken as whole ones; memory that cores share gets no wider.
ExpectedSpeedUp ExpectSpeedUp(const ScalingBasis& basis, int threads);

// What of the time outside of the rollouts, by one thread and by n, does not shrink with threads:
// a in [0, outside_one] of outside = a + b / threads.
double SerialSeconds(double outside_one, double outside_n, int n);

}  // namespace downpour
