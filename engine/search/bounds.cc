// SPDX-License-Identifier: Apache-2.0
#include "engine/search/bounds.h"

#include <algorithm>
#include <cmath>

namespace downpour {

BoxTransform::BoxTransform(double lower, double upper)
    : lower_(lower),
      upper_(upper),
      lower_margin_(std::min((upper - lower) / 2, (1 + std::abs(lower)) / 20)),
      upper_margin_(std::min((upper - lower) / 2, (1 + std::abs(upper)) / 20)),
      identity_from_(lower + lower_margin_),
      identity_to_(upper - upper_margin_) {}

double BoxTransform::Mirrored(double x) const {
  // Into one period, symmetric about the box, then mirrored into the invertible part.
  const double lowest = lower_ - 2 * lower_margin_ - (upper_ - lower_) / 2;
  const double period = 2 * (upper_ - lower_ + lower_margin_ + upper_margin_);
  x = lowest + std::fmod(x - lowest, period);
  if (x < lowest) x += period;
  const double first = lower_ - lower_margin_, last = upper_ + upper_margin_;
  if (x < first) x = 2 * first - x;
  if (x > last) x = 2 * last - x;
  return x;
}

double BoxTransform::ToBoxAtBounds(double x) const {
  const double first = lower_ - lower_margin_, last = upper_ + upper_margin_;
  if (!(x >= first && x <= last)) x = Mirrored(x);
  if (x < identity_from_) {
    return lower_ + (x - first) * (x - first) / (4 * lower_margin_);
  }
  if (x < identity_to_) return x;
  return upper_ - (x - last) * (x - last) / (4 * upper_margin_);
}

double BoxTransform::FromBox(double y) const {
  if (y < identity_from_) {
    return lower_ - lower_margin_ + 2 * std::sqrt(lower_margin_ * (y - lower_));
  }
  if (y < identity_to_) return y;
  return upper_ + upper_margin_ - 2 * std::sqrt(upper_margin_ * (upper_ - y));
}

}  // namespace downpour
