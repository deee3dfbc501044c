// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/expected_scaling.h"

#include <algorithm>
#include <cmath>

#include "engine/rollout/tiling.h"

namespace downpour {
namespace {

// Lanes that are computed for n in one tile or several whole ones.
double ComputedLanes(double n, int tile_unit) { return tile_unit * std::ceil(n / tile_unit); }

// How long `threads` threads take for a generation, by the lanes that one computes in that time. As
// long as each thread has a run, threads take runs of their own, fair shares of them (RunQueue),
// and those with fewer are through more generations; else all threads share the batch.
double GenerationTime(const GenerationLanes& generation, int threads, int tile_unit) {
  if (generation.runs >= threads) {
    const int fewer = generation.runs / threads, with_more = generation.runs % threads;
    const auto rate = [&](int runs) {  // of one thread
      const double lanes = static_cast<double>(runs) * generation.lanes / generation.runs;
      return runs / ComputedLanes(lanes, tile_unit);
    };
    double runs = (threads - with_more) * rate(fewer);
    if (with_more > 0) runs += with_more * rate(fewer + 1);
    return generation.runs / runs;
  }
  const Tiling tiling(generation.lanes, threads, tile_unit);
  double time = 0;
  for (int tile = 0; tile < tiling.count(); tile += threads) {  // the larger come first
    time += ComputedLanes(tiling.Size(tile), tile_unit);
  }
  return time;
}

// How much sooner `threads` threads are through all generations than one.
double TileGain(const ScalingBasis& basis, int threads) {
  double one = 0, all = 0;
  for (const GenerationLanes& generation : basis.generations) {
    one += GenerationTime(generation, 1, basis.tile_unit);
    all += GenerationTime(generation, threads, basis.tile_unit);
  }
  return all > 0 ? std::max(1.0, one / all) : 1;
}

}  // namespace

ExpectedSpeedUp ExpectSpeedUp(const ScalingBasis& basis, int threads) {
  const auto measured = static_cast<int>(basis.fma_gain.size());
  const int known = std::min(threads, measured);
  const double fma = basis.fma_gain[known - 1] + (threads - known);
  const double tiles = TileGain(basis, threads);
  double width = basis.gigabytes_per_second[known - 1];
  if (!basis.shared_memory) width *= static_cast<double>(threads) / known;
  const double bandwidth = width > 0 && basis.demand > 0 ? width / basis.demand : threads;
  const double gain = std::min({fma, tiles, bandwidth});
  const double time =
      basis.serial_seconds + (basis.seconds - basis.serial_seconds) / std::max(gain, 1e-3);
  return {threads, basis.seconds / time,
          gain == tiles && tiles < fma ? "tiles"
          : gain == fma                ? "FMA"
                                       : "bandwidth"};
}

double SerialSeconds(double outside_one, double outside_n, int n) {
  if (n == 1) return outside_one;
  return std::clamp((n * outside_n - outside_one) / (n - 1), 0.0, outside_one);
}

}  // namespace downpour
