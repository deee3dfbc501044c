// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include "kernels/box/box.h"

namespace downpour {

// Scalar long-double twin of MapToBox.
inline long double MapToBoxReference(const BoxMap& box, long double x) {
  const long double first = box.lower - static_cast<long double>(box.lower_margin);
  const long double last = box.upper + static_cast<long double>(box.upper_margin);
  // Steps from `first` along the zigzag between the mirrors.
  const long double width = last - first;
  long double step = std::fmod(x - first, 2 * width);
  if (step < 0) step += 2 * width;
  x = step <= width ? first + step : last - (step - width);
  const long double from = first + 2 * static_cast<long double>(box.lower_margin);
  const long double to = last - 2 * static_cast<long double>(box.upper_margin);
  if (x < from) return box.lower + (x - first) * (x - first) / (4 * box.lower_margin);
  if (x > to) return box.upper - (x - last) * (x - last) / (4 * box.upper_margin);
  return x;
}

}  // namespace downpour
