// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <vector>

#include "kernels/aligned.h"
#include "tests/kernels/each_target.h"

namespace downpour {

// A tile of numbers in +-scale.
inline AlignedVector<double> RandomTile(int rows, double scale, TestNumbers& random) {
  AlignedVector<double> tile(static_cast<std::size_t>(rows) * kTileLanes);
  for (double& x : tile) x = scale * random();
  return tile;
}

// One lane of a tile.
inline std::vector<double> Column(const AlignedVector<double>& tile, int lane) {
  std::vector<double> column(tile.size() / kTileLanes);
  for (std::size_t r = 0; r < column.size(); ++r) column[r] = tile[r * kTileLanes + lane];
  return column;
}

}  // namespace downpour
