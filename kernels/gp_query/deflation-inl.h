// SPDX-License-Identifier: Apache-2.0

// From e to e' (gp_query.h), in Highway's current target.
#if defined(DOWNPOUR_DEFLATION_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_DEFLATION_INL_H_
#undef DOWNPOUR_DEFLATION_INL_H_
#else
#define DOWNPOUR_DEFLATION_INL_H_
#endif

#include "hwy/highway.h"
#include "kernels/gp_query/triangle_layout.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Replaces e of the first kRowBlock points by z, V_first z = e_first, by forward substitution; `v`
// holds V_first. kWidth vectors of D are one point.
template <int kWidth, class D, typename T = hn::TFromD<D>>
HWY_INLINE void SolveFirst(D d, const T* HWY_RESTRICT v, T* HWY_RESTRICT e) {
  const size_t lanes = hn::Lanes(d);
  for (int i = 0; i < kRowBlock; ++i) {
    for (size_t lane = 0; lane < kWidth * lanes; lane += lanes) {
      auto z = hn::Load(d, e + i * kWidth * lanes + lane);
      for (int k = 0; k < i; ++k) {
        const auto vk = hn::Set(d, v[k * kRowBlock + i]);
        z = hn::NegMulAdd(vk, hn::Load(d, e + k * kWidth * lanes + lane), z);
      }
      hn::Store(hn::Mul(z, hn::Set(d, v[i * kRowBlock + i])), d, e + i * kWidth * lanes + lane);
    }
  }
}

// Takes V z from e of kRowBlock other points; `v` holds their rows of V.
template <int kWidth, typename T>
HWY_INLINE void SubtractExplained(const T* HWY_RESTRICT v, const T* HWY_RESTRICT first,
                                  T* HWY_RESTRICT e) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const size_t lanes = hn::Lanes(d);
  V z[kRowBlock][kWidth];
  for (int k = 0; k < kRowBlock; ++k) {
    for (int w = 0; w < kWidth; ++w) z[k][w] = hn::Load(d, first + (k * kWidth + w) * lanes);
  }
  for (int i = 0; i < kRowBlock; ++i, e += kWidth * lanes) {
    V left[kWidth];
    for (int w = 0; w < kWidth; ++w) left[w] = hn::Load(d, e + w * lanes);
    HWY_UNROLL(8) for (int k = 0; k < kRowBlock; ++k) {
      const V vk = hn::Set(d, v[k * kRowBlock + i]);
      for (int w = 0; w < kWidth; ++w) left[w] = hn::NegMulAdd(vk, z[k][w], left[w]);
    }
    for (int w = 0; w < kWidth; ++w) hn::Store(left[w], d, e + w * lanes);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_DEFLATION_INL_H_
