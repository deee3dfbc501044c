// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>

#include "kernels/squash/squash.h"

namespace downpour {

// Scalar long-double twin of Squash (PILCO's squashing function).
inline long double SquashReference(long double a) {
  const long double x = std::clamp<long double>(a, -kSquashLimit, kSquashLimit);
  return (9 * std::sin(x) + std::sin(3 * x)) / 8;
}

}  // namespace downpour
