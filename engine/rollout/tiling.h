// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <variant>

#include "engine/gp/query_plan.h"
#include "kernels/aligned.h"
#include "kernels/fma_peak/fma_peak.h"

namespace downpour {

// Tiles of kTileLanes lanes that hold n.
inline int WholeTiles(int n) { return (n + kTileLanes - 1) / kTileLanes; }

// Lanes of a tile that begins `before` lanes into a block of n.
inline int TileLanes(int n, int before) { return std::min(kTileLanes, n - before); }

// What tiles hold multiples of: the lanes of a vector on this machine, of floats if any factor has
// them; 16, or 8, which are two vectors of double with AVX2.
inline int TileUnit(bool single_precision) {
  return std::max(8, SimdFloatLanes() / (single_precision ? 1 : 2));
}
inline int TileUnit(std::span<const QueryFactor> factors) {
  return TileUnit(std::any_of(factors.begin(), factors.end(), [](const QueryFactor& factor) {
    return std::holds_alternative<GpFactor32>(factor);
  }));
}

// How the lanes of a batch are cut into tiles of at most kTileLanes, all but the last of whole
// units: as even as can be, larger ones first, and as many as give every thread the same number.
// Full tiles instead would leave one of two threads idle for two fifths of the time that 128 lanes
// take (four instances of CMA-ES on cart-pole).
class Tiling {
 public:
  // n_lanes in [0, 2^31 - kTileLanes), threads >= 1; unit divides kTileLanes.
  Tiling(int n_lanes, int threads, int unit)
      : n_lanes_(n_lanes), unit_(unit), n_units_((n_lanes + unit - 1) / unit) {
    const int full = WholeTiles(n_lanes);
    const int rounds = (full + threads - 1) / threads;
    count_ = static_cast<int>(
        std::min<std::int64_t>(n_units_, static_cast<std::int64_t>(rounds) * threads));
  }

  int count() const { return count_; }
  // Of all tiles together, for any number of threads: n_lanes rounded up to whole units.
  int computed_lanes() const { return n_units_ * unit_; }
  // First lane of a tile, tile <= count(); that of tile count() is n_lanes. Not of an empty batch.
  int First(int tile) const {
    const int units = tile * (n_units_ / count_) + std::min(tile, n_units_ % count_);
    return std::min(units * unit_, n_lanes_);
  }
  int Size(int tile) const { return First(tile + 1) - First(tile); }

 private:
  int n_lanes_, unit_, n_units_, count_;
};

}  // namespace downpour
