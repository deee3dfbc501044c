// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include "kernels/reward/reward.h"

namespace downpour {

// Scalar long-double twin of SaturatingRewardTile for one lane.
inline long double SaturatingRewardReference(int n_rows, int n_features, const double* a,
                                             const double* b, double width,
                                             const double* features) {
  long double distance = 0;
  for (int r = 0; r < n_rows; ++r) {
    long double y = -static_cast<long double>(b[r]);
    for (int f = 0; f < n_features; ++f) {
      y += static_cast<long double>(a[r * n_features + f]) * features[f];
    }
    distance += y * y;
  }
  return std::exp(-distance / (2 * static_cast<long double>(width) * width));
}

}  // namespace downpour
