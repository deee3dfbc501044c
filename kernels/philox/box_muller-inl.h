// SPDX-License-Identifier: Apache-2.0
// The functions of the Box-Muller transform, on the ranges that it needs: faster than Highway's,
// which serve every argument and share nothing between cosine and sine.

// Include guard for each target.
#if defined(DOWNPOUR_BOX_MULLER_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_BOX_MULLER_INL_H_
#undef DOWNPOUR_BOX_MULLER_INL_H_
#else
#define DOWNPOUR_BOX_MULLER_INL_H_
#endif

#include <cstddef>
#include <cstdint>

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Polynomial in t, highest coefficient first.
template <class D, std::size_t kSize>
HWY_INLINE hn::Vec<D> Polynomial(D d, hn::Vec<D> t, const double (&coefficients)[kSize]) {
  auto sum = hn::Set(d, coefficients[0]);
  for (std::size_t i = 1; i < kSize; ++i) sum = hn::MulAdd(sum, t, hn::Set(d, coefficients[i]));
  return sum;
}

// ln u for normal u in (0, 1], within 4 ulp: u = 2^e m with m in [sqrt(1/2), sqrt(2)), and
// ln m = 2 atanh s with s = (m - 1) / (m + 1), |s| < 0.172, by its series, cut off below 2^-55.
template <class D>
HWY_INLINE hn::Vec<D> LogOfUniform(D d, hn::Vec<D> u) {
  const hn::RebindToSigned<D> di;
  static constexpr double kSeries[] = {2.0 / 21, 2.0 / 19, 2.0 / 17, 2.0 / 15, 2.0 / 13, 2.0 / 11,
                                       2.0 / 9,  2.0 / 7,  2.0 / 5,  2.0 / 3,  2.0};
  // Bits of sqrt(1/2): what u's bits exceed them by carries e in the exponent's place.
  const auto root = hn::Set(di, std::int64_t{0x3FE6A09E667F3BCD});
  const auto bits = hn::Sub(hn::BitCast(di, u), root);
  const auto exponent = hn::ShiftRight<52>(bits);
  const auto mantissa = hn::Add(hn::And(bits, hn::Set(di, (std::int64_t{1} << 52) - 1)), root);
  const auto m = hn::BitCast(d, mantissa);
  const auto one = hn::Set(d, 1.0);
  const auto s = hn::Div(hn::Sub(m, one), hn::Add(m, one));
  const auto log_m = hn::Mul(s, Polynomial(d, hn::Mul(s, s), kSeries));
  return hn::MulAdd(hn::ConvertTo(d, exponent), hn::Set(d, 0.693147180559945309417), log_m);
}

// cos 2 pi u and sin 2 pi u for u in [0, 1), a multiple of 2^-52, within 2^-52: u less the nearest
// quarter is exact, and both series in the angle, |x| <= pi / 4, are cut off below 2^-55.
template <class D>
HWY_INLINE void CosSinOfTurns(D d, hn::Vec<D> u, hn::Vec<D>* cosine, hn::Vec<D>* sine) {
  const hn::RebindToUnsigned<D> du;
  static constexpr double kCosine[] = {1.0 / 20922789888000,
                                       -1.0 / 87178291200,
                                       1.0 / 479001600,
                                       -1.0 / 3628800,
                                       1.0 / 40320,
                                       -1.0 / 720,
                                       1.0 / 24,
                                       -1.0 / 2,
                                       1.0};
  static constexpr double kSine[] = {
      -1.0 / 1307674368000, 1.0 / 6227020800, -1.0 / 39916800, 1.0 / 362880,
      -1.0 / 5040,          1.0 / 120,        -1.0 / 6,        1.0};
  // Adding 1.5 2^52 rounds to a whole number, which is then in the low bits.
  const auto magic = hn::Set(d, 6755399441055744.0);
  const auto shifted = hn::MulAdd(u, hn::Set(d, 4.0), magic);
  const auto quarter = hn::BitCast(du, shifted);
  const auto rest = hn::NegMulAdd(hn::Sub(shifted, magic), hn::Set(d, 0.25), u);
  const auto x = hn::Mul(rest, hn::Set(d, 6.283185307179586477));
  const auto t = hn::Mul(x, x);
  const auto c = Polynomial(d, t, kCosine), s = hn::Mul(x, Polynomial(d, t, kSine));
  // Odd quarters swap them; quarters 1 and 2 have negative cosines, 2 and 3 negative sines.
  const auto odd = hn::Eq(hn::And(quarter, hn::Set(du, 1)), hn::Set(du, 1));
  const auto swap = hn::RebindMask(d, odd);
  const auto sign = hn::Set(du, std::uint64_t{1} << 63);
  const auto sign_c = hn::And(hn::ShiftLeft<62>(hn::Add(quarter, hn::Set(du, 1))), sign);
  const auto sign_s = hn::And(hn::ShiftLeft<62>(quarter), sign);
  *cosine = hn::Xor(hn::IfThenElse(swap, s, c), hn::BitCast(d, sign_c));
  *sine = hn::Xor(hn::IfThenElse(swap, c, s), hn::BitCast(d, sign_s));
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_BOX_MULLER_INL_H_
