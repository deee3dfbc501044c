// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "kernels/box/box.h"

namespace downpour {

// Smooth map from the real line onto [lower, upper], so that an unbounded search respects bounds:
// the identity but for a quadratic piece beside each bound (BoxConstraintsLinQuadTransformation of
// pycma, linear-quadratic boundary transformation of libcmaes). Outside of [lower - a, upper + a]
// the map is mirrored and periodic, so every real number has an image. Thread-safe.
class BoxTransform {
 public:
  // lower < upper, both finite.
  BoxTransform(double lower, double upper);

  // Image of a finite x, in [lower, upper].
  double ToBox(double x) const {
    MapToBox(map_, 1, &x);
    return x;
  }
  // Images of finite numbers, in their place.
  void ToBox(std::span<double> values) const { MapToBox(map_, values.size(), values.data()); }
  // The preimage in [lower - a, upper + a] of y in [lower, upper].
  double FromBox(double y) const;

 private:
  BoxMap map_;
};

}  // namespace downpour
