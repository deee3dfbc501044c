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
  // Lanes of the widest vector, 16 floats.
  static constexpr int kVectorLanes = 16;

  // n_lanes in [0, 2^31 - kTileLanes), threads >= 1.
  Tiling(int n_lanes, int threads)
      : n_lanes_(n_lanes), n_vectors_((n_lanes + kVectorLanes - 1) / kVectorLanes) {
    const int full = (n_lanes + kTileLanes - 1) / kTileLanes;
    const int rounds = (full + threads - 1) / threads;
    count_ = static_cast<int>(
        std::min<std::int64_t>(n_vectors_, static_cast<std::int64_t>(rounds) * threads));
  }

  int count() const { return count_; }
  // Of all tiles together, for any number of threads: n_lanes rounded up to whole vectors.
  int computed_lanes() const { return n_vectors_ * kVectorLanes; }
  // First lane of a tile, tile <= count(); that of tile count() is n_lanes. Not of an empty batch.
  int First(int tile) const {
    const int vectors = tile * (n_vectors_ / count_) + std::min(tile, n_vectors_ % count_);
    return std::min(vectors * kVectorLanes, n_lanes_);
  }
  int Size(int tile) const { return First(tile + 1) - First(tile); }

 private:
  int n_lanes_, n_vectors_, count_;
};

}  // namespace downpour
