// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include "kernels/features/features.h"

namespace downpour {

// Scalar long-double twin of FeatureTile: one feature of one state variable.
inline long double FeatureReference(FeatureKind kind, double state) {
  const long double x = state;
  if (kind == FeatureKind::kCosine) return std::cos(x);
  if (kind == FeatureKind::kSine) return std::sin(x);
  return x;
}

}  // namespace downpour
