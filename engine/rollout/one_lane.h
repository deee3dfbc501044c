// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "kernels/aligned.h"

namespace downpour {

// A vector as lane 0 of a tile (the other lanes are zero), to run a tile kernel on one sample.
inline AlignedVector<double> ToOneLane(std::span<const double> values) {
  AlignedVector<double> tile(values.size() * kTileLanes, 0.0);
  for (std::size_t i = 0; i < values.size(); ++i) tile[i * kTileLanes] = values[i];
  return tile;
}

// Lane 0 of a tile.
inline void FromOneLane(const AlignedVector<double>& tile, std::span<double> values) {
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = tile[i * kTileLanes];
}

}  // namespace downpour
