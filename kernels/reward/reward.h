// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "kernels/aligned.h"

namespace downpour {

// Saturating reward (paper Eq. 9) of a tile: rewards[lane] = exp(-|A f - b|^2 / (2 width^2)).
//   a         n_rows x n_features row-major; b (n_rows)
//   features  n_features x kTileLanes; rewards kTileLanes; aligned, no aliasing
// In [0, 1]. Thread-safe, does not allocate.
void SaturatingRewardTile(int n_rows, int n_features, const double* a, const double* b,
                          double width, const double* features, double* rewards);

}  // namespace downpour
