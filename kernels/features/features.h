// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "kernels/aligned.h"

namespace downpour {

// One entry of the feature vector that the model and the policy see: a state variable, or the
// cosine or sine of one (an angle jumps at +-pi, its features do not).
enum class FeatureKind { kIdentity, kCosine, kSine };
struct Feature {
  FeatureKind kind;
  int state_index;
};

// features[f][lane] of states[e][lane]: states E x kTileLanes, features n_features x kTileLanes,
// aligned, no aliasing. Cosine and sine within 3 ulp for |state| <= 39000 (Highway), not specified
// beyond. Thread-safe, does not allocate.
void FeatureTile(const Feature* map, int n_features, const double* states, double* features);

}  // namespace downpour
