// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>

#include "kernels/transition/transition.h"

namespace downpour {

// Scalar long-double twin of TransitionTile for one lane: the new state, before the limit.
inline long double TransitionReference(double state, double mean, double variance,
                                       double noise_variance, double z, double clamp) {
  const double sample = clamp > 0 ? std::clamp(z, -clamp, clamp) : z;
  return static_cast<long double>(state) + mean +
         std::sqrt(static_cast<long double>(variance) + noise_variance) * sample;
}

}  // namespace downpour
