// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace downpour {

// A map of the real line onto [lower, upper]: the identity on [lower + lower_margin,
// upper - upper_margin]; a parabola beside each bound, which meets it with slope 0 at
// lower - lower_margin and at upper + upper_margin; mirrored at these two, and so periodic. Margins
// are > 0 and at most half of upper - lower.
struct BoxMap {
  double lower = 0, upper = 0;
  double lower_margin = 0, upper_margin = 0;
};

// values[i] = its image, in [lower, upper], for n finite numbers. Within the two mirrors the error
// is some ulp of the box's size; outside it grows with the number as the spacing of doubles does.
// Vectorised; the bits are the same for every n on one SIMD target. Thread-safe, does not allocate.
void MapToBox(const BoxMap& box, std::size_t n, double* values);

}  // namespace downpour
