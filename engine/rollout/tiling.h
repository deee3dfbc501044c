// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>

#include "kernels/aligned.h"

namespace downpour {

// Tiles of kTileLanes lanes that hold n.
inline int WholeTiles(int n) { return (n + kTileLanes - 1) / kTileLanes; }

// Lanes of a tile that begins `before` lanes into a block of n.
inline int TileLanes(int n, int before) { return std::min(kTileLanes, n - before); }

// How the lanes of a batch are cut into tiles of at most kTileLanes, all but the last of whole
// vectors: as even as can be, larger ones first, and as many as give every thread the same number.
// Full tiles instead would leave one of two threads idle for two fifths of the time that 128 lanes
// take (four instances of CMA-ES on cart-pole).
class Tiling {
 public:
  // Lanes of the widest vector, 16 floats; half of it holds 8 doubles, and 8 floats with AVX2.
  static constexpr int kVectorLanes = 16, kHalfVectorLanes = 8;

  // n_lanes in [0, 2^31 - kTileLanes), threads >= 1.
  Tiling(int n_lanes, int threads) : n_lanes_(n_lanes) {
    const int full = WholeTiles(n_lanes);
    const int rounds = (full + threads - 1) / threads;
    const std::int64_t most = std::int64_t{rounds} * threads;
    const auto cut = [&](int unit) {
      unit_ = unit;
      n_units_ = (n_lanes + unit - 1) / unit;
      count_ = static_cast<int>(std::min<std::int64_t>(n_units_, most));
    };
    cut(kVectorLanes);
    if (n_lanes == 0 || threads == 1) return;
    // Several threads wait for the one with the largest tiles, which halves of vectors may make
    // smaller, though a few more vectors may be computed: 96 lanes for four threads.
    const int largest = LargestTile();
    cut(kHalfVectorLanes);
    if (LargestTile() >= largest) cut(kVectorLanes);
  }

  int count() const { return count_; }
  // All tiles but the last have a multiple of so many lanes: kVectorLanes or kHalfVectorLanes.
  int unit() const { return unit_; }
  // n_lanes rounded up to whole vectors: what one thread computes at most.
  int computed_lanes() const { return (n_lanes_ + kVectorLanes - 1) / kVectorLanes * kVectorLanes; }
  // First lane of a tile, tile <= count(); that of tile count() is n_lanes. Not of an empty batch.
  int First(int tile) const {
    const int units = tile * (n_units_ / count_) + std::min(tile, n_units_ % count_);
    return std::min(units * unit_, n_lanes_);
  }
  int Size(int tile) const { return First(tile + 1) - First(tile); }

 private:
  int LargestTile() const { return (n_units_ + count_ - 1) / count_ * unit_; }

  int n_lanes_, unit_, n_units_, count_;
};

}  // namespace downpour
