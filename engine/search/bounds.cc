// SPDX-License-Identifier: Apache-2.0
#include "engine/search/bounds.h"

#include <algorithm>
#include <cmath>

namespace downpour {

BoxTransform::BoxTransform(double lower, double upper)
    : map_{lower, upper, std::min((upper - lower) / 2, (1 + std::abs(lower)) / 20),
           std::min((upper - lower) / 2, (1 + std::abs(upper)) / 20)} {}

double BoxTransform::FromBox(double y) const {
  const auto& [lower, upper, lower_margin, upper_margin] = map_;
  if (y < lower + lower_margin) {
    return lower - lower_margin + 2 * std::sqrt(lower_margin * (y - lower));
  }
  if (y < upper - upper_margin) return y;
  return upper + upper_margin - 2 * std::sqrt(upper_margin * (upper - y));
}

}  // namespace downpour
