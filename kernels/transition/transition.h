// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "kernels/aligned.h"

namespace downpour {

// One state variable's step of a tile (paper Eq. 7 with a sampled transition):
//   state += mean + sqrt(variance + noise_variance) z,  z clamped to +-clamp if clamp > 0.
//   state, mean, variance, z  kTileLanes each; variance nullptr: state += mean (z is not read)
//   alive  kTileLanes of 1 or 0. A lane whose new state is not within +-limit (or is NaN) gets
//          alive = 0 and state = 0, so that it stays finite.
// Aligned, no aliasing. Thread-safe, does not allocate.
void TransitionTile(const double* mean, const double* variance, double noise_variance,
                    const double* z, double clamp, double limit, double* state, double* alive);

}  // namespace downpour
