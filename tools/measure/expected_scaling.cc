// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/expected_scaling.h"

#include <algorithm>

#include "engine/rollout/tiling.h"

namespace downpour {
namespace {

// How much sooner `threads` threads are through the tiles of all batches than one.
double TileGain(std::span<const int> batch_lanes, int threads) {
  double work = 0, longest = 0;
  for (const int lanes : batch_lanes) {
    const Tiling tiling(lanes, threads);
    if (lanes == 0) continue;
    const int rounds = (tiling.count() + threads - 1) / threads;
    work += tiling.computed_lanes();
    // Tiles are even but for a vector; the larger come first.
    double time = 0;
    for (int round = 0; round < rounds; ++round) time += tiling.Size(round * threads);
    longest += std::max(time, static_cast<double>(Tiling::kVectorLanes));
  }
  return longest > 0 ? std::max(1.0, work / longest) : 1;
}

}  // namespace

ExpectedSpeedUp ExpectSpeedUp(const ScalingBasis& basis, int threads) {
  const auto measured = static_cast<int>(basis.fma_gain.size());
  const int known = std::min(threads, measured);
  const double fma = basis.fma_gain[known - 1] + (threads - known);
  const double tiles = TileGain(basis.batch_lanes, threads);
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
