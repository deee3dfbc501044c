// SPDX-License-Identifier: Apache-2.0
#pragma once

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
    return x >= identity_from_ && x <= identity_to_ ? x : ToBoxAtBounds(x);
  }
  // The preimage in [lower - a, upper + a] of y in [lower, upper].
  double FromBox(double y) const;

 private:
  double ToBoxAtBounds(double x) const;
  // The number in [lower - a, upper + a] that x is mirrored to.
  double Mirrored(double x) const;

  double lower_, upper_;
  double lower_margin_, upper_margin_;  // a: half-widths of the quadratic pieces
  double identity_from_, identity_to_;  // lower + a, upper - a
};

}  // namespace downpour
