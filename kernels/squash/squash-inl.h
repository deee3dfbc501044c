// SPDX-License-Identifier: Apache-2.0

// The squashing function of actions in Highway's current target.
#if defined(DOWNPOUR_SQUASH_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_SQUASH_INL_H_
#undef DOWNPOUR_SQUASH_INL_H_
#else
#define DOWNPOUR_SQUASH_INL_H_
#endif

#include "hwy/contrib/math/math-inl.h"
#include "hwy/highway.h"
#include "kernels/squash/squash.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// kappa(a) = 9/8 sin a + 1/8 sin 3a = (3 sin a - sin^3 a) / 2 of a vector, in [-1, 1]; a is clipped
// to +-kSquashLimit first. Within 6 ulp of 1.
template <class D, class V = hn::Vec<D>>
HWY_INLINE V Squash(D d, V a) {
  const V limit = hn::Set(d, kSquashLimit), one = hn::Set(d, 1.0);
  const V sine = hn::Sin(d, hn::Clamp(a, hn::Neg(limit), limit));
  const V half = hn::Mul(hn::Set(d, 0.5), sine);
  const V squashed = hn::Mul(half, hn::NegMulAdd(sine, sine, hn::Set(d, 3.0)));
  return hn::Clamp(squashed, hn::Neg(one), one);
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_SQUASH_INL_H_
