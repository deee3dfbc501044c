// SPDX-License-Identifier: Apache-2.0

// 2^-s for s >= 0 in the bits of Highway's current target.
#if defined(DOWNPOUR_EXP2_NEGATIVE_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_EXP2_NEGATIVE_INL_H_
#undef DOWNPOUR_EXP2_NEGATIVE_INL_H_
#else
#define DOWNPOUR_EXP2_NEGATIVE_INL_H_
#endif

#include <cstdint>
#include <iterator>

#include "hwy/highway.h"
#include "kernels/gp_query/exp2_table-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// (2^-q - 1)/q on [-1/2, 1/2], interpolated at the Chebyshev nodes and rounded: 2^-q is within
// 2.0e-17 (double) and 9.2e-9 (float) of the truth before the rounding of its evaluation.
template <typename T>
struct Exp2NegativeConstants;
template <>
struct Exp2NegativeConstants<double> {
  using Bits = std::uint64_t;
  static constexpr int kMantissaBits = 52;
  static constexpr int kExponentBias = 1023;
  static constexpr double kPolynomial[] = {
      -0.69314718055994529,    0.24022650695910097,    -0.055504108664821597,
      0.0096181291076068882,   -0.0013333558146416936, 0.0001540353044173605,
      -1.5252733829836119e-05, 1.3215442587921689e-06, -1.0178062445845774e-07,
      7.0725859492692234e-09,  -4.4549605981865186e-10};
};
template <>
struct Exp2NegativeConstants<float> {
  using Bits = std::uint32_t;
  static constexpr int kMantissaBits = 23;
  static constexpr int kExponentBias = 127;
  static constexpr float kPolynomial[] = {-0.693147182f,  0.240226507f,    -0.0555035695f,
                                          0.00961808302f, -0.00133908633f, 0.000154531634f};
};

// Replaces s by 2^-s in kCount vectors; their steps alternate, as one polynomial alone waits for
// the latency of its own multiply-adds. Within 1.2 ulp while the result is normal; exactly 1 at 0,
// exactly 0 from 1022.5 (double) or 126.5 (float) on, infinity included. NaN gives anything finite
// or NaN.
template <int kCount, class D, class V = hn::Vec<D>>
HWY_INLINE void Exp2Negative(D d, V (&s)[kCount]) {
#if HWY_TARGET <= HWY_AVX3
  Exp2ByTable(d, s);
#else
  using T = hn::TFromD<D>;
  using C = Exp2NegativeConstants<T>;
  const hn::Rebind<typename C::Bits, D> d_bits;
  constexpr int kLast = static_cast<int>(std::size(C::kPolynomial)) - 1;
  // The low bits of shifter - s are the exponent field of 2^-k, k = s rounded; 0 for the largest k.
  const V shifter =
      hn::Set(d, T(1.5) * T(std::uint64_t{1} << C::kMantissaBits) + T(C::kExponentBias));
  V power[kCount], p[kCount];
  for (int i = 0; i < kCount; ++i) {
    s[i] = hn::Min(s[i], hn::Set(d, T(C::kExponentBias)));
    const V shifted = hn::Sub(shifter, s[i]);
    power[i] = hn::BitCast(d, hn::ShiftLeft<C::kMantissaBits>(hn::BitCast(d_bits, shifted)));
    s[i] = hn::Add(s[i], hn::Sub(shifted, shifter));  // s - k, exact
    p[i] = hn::Set(d, C::kPolynomial[kLast]);
  }
  HWY_UNROLL(16) for (int c = kLast - 1; c >= 0; --c) {
    for (int i = 0; i < kCount; ++i) p[i] = hn::MulAdd(p[i], s[i], hn::Set(d, C::kPolynomial[c]));
  }
  for (int i = 0; i < kCount; ++i) {
    s[i] = hn::Mul(hn::MulAdd(p[i], s[i], hn::Set(d, T(1))), power[i]);
  }
#endif
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_EXP2_NEGATIVE_INL_H_
