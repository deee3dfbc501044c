// SPDX-License-Identifier: Apache-2.0

// 2^-s by a table of the sixteenth roots of 2, in Highway's current target: on AVX-512 a table fits
// into one or two registers and spares the longer polynomial (13 instructions instead of 18).
#if defined(DOWNPOUR_EXP2_TABLE_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_EXP2_TABLE_INL_H_
#undef DOWNPOUR_EXP2_TABLE_INL_H_
#else
#define DOWNPOUR_EXP2_TABLE_INL_H_
#endif

#include <array>
#include <bit>
#include <cstdint>
#include <iterator>
#include <limits>

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

#if HWY_TARGET <= HWY_AVX3

constexpr int kTableBits = 4;
template <typename T>
constexpr int kTableShift = std::numeric_limits<T>::digits - 1 - kTableBits;
template <typename T>
constexpr int kExponentBias = std::numeric_limits<T>::max_exponent - 1;

// (2^-q - 1)/q on [-1/32, 1/32], interpolated at the Chebyshev nodes and rounded: 2^-q is within
// 1.5e-17 (double) and 2.4e-9 (float) of the truth before the rounding of its evaluation.
template <typename T>
struct Exp2TablePolynomial;
template <>
struct Exp2TablePolynomial<double> {
  static constexpr double kTerms[] = {-0.6931471805599457,    0.24022650695910075,
                                      -0.0555041086566393,    0.009618129106919537,
                                      -0.0013333781576784268, 0.00015403723980749256};
};
template <>
struct Exp2TablePolynomial<float> {
  static constexpr float kTerms[] = {-0.693147182f, 0.240233555f, -0.0555050857f};
};

// 2^(f/16).
constexpr double kRoots[1 << kTableBits] = {1.0,
                                            1.0442737824274138,
                                            1.0905077326652577,
                                            1.1387886347566916,
                                            1.189207115002721,
                                            1.241857812073484,
                                            1.2968395546510096,
                                            1.3542555469368927,
                                            1.4142135623730951,
                                            1.4768261459394993,
                                            1.5422108254079407,
                                            1.6104903319492543,
                                            1.681792830507429,
                                            1.7562521603732995,
                                            1.8340080864093424,
                                            1.9152065613971474};

// Entry f makes the bits of 2^(e - bias + f/16) when 16 e + f is added to it, shifted to where its
// e is the exponent field.
template <typename T>
constexpr auto MakeExp2Table() {
  using Bits = hwy::MakeUnsigned<T>;
  std::array<Bits, 1 << kTableBits> table{};
  for (unsigned f = 0; f < table.size(); ++f) {
    table[f] = std::bit_cast<Bits>(static_cast<T>(kRoots[f])) - std::bit_cast<Bits>(T(1)) -
               (Bits{f} << kTableShift<T>);
  }
  return table;
}
template <typename T>
alignas(64) constexpr auto kExp2Table = MakeExp2Table<T>();

// s less its nearest sixteenth, ties to even; 0 for infinity.
constexpr int kFractionOf16th = kTableBits << 4 | _MM_FROUND_NO_EXC;
HWY_INLINE hn::Vec512<double> FractionOf16th(hn::Vec512<double> s) {
  return hn::Vec512<double>{_mm512_reduce_pd(s.raw, kFractionOf16th)};
}
HWY_INLINE hn::Vec512<float> FractionOf16th(hn::Vec512<float> s) {
  return hn::Vec512<float>{_mm512_reduce_ps(s.raw, kFractionOf16th)};
}
HWY_INLINE hn::Vec256<float> FractionOf16th(hn::Vec256<float> s) {
  return hn::Vec256<float>{_mm256_reduce_ps(s.raw, kFractionOf16th)};
}

// The power whose bits are 16 e + f in the low bits of `shifted`; 0 unless s <= largest.
HWY_INLINE hn::Vec512<double> Power16th(hn::Vec512<double> shifted, hn::Vec512<double> s,
                                        double largest) {
  const __m512i i = _mm512_castpd_si512(shifted.raw);
  const auto* const table = reinterpret_cast<const double*>(kExp2Table<double>.data());
  const __m512d entry = _mm512_permutex2var_pd(_mm512_load_pd(table), i, _mm512_load_pd(table + 8));
  const __mmask8 in_range = _mm512_cmp_pd_mask(s.raw, _mm512_set1_pd(largest), _CMP_LE_OQ);
  return hn::Vec512<double>{_mm512_castsi512_pd(_mm512_maskz_add_epi64(
      in_range, _mm512_castpd_si512(entry), _mm512_slli_epi64(i, kTableShift<double>)))};
}
HWY_INLINE hn::Vec512<float> Power16th(hn::Vec512<float> shifted, hn::Vec512<float> s,
                                       float largest) {
  const __m512i i = _mm512_castps_si512(shifted.raw);
  const __m512i entry = _mm512_permutexvar_epi32(i, _mm512_load_si512(kExp2Table<float>.data()));
  const __mmask16 in_range = _mm512_cmp_ps_mask(s.raw, _mm512_set1_ps(largest), _CMP_LE_OQ);
  return hn::Vec512<float>{_mm512_castsi512_ps(
      _mm512_maskz_add_epi32(in_range, entry, _mm512_slli_epi32(i, kTableShift<float>)))};
}
HWY_INLINE hn::Vec256<float> Power16th(hn::Vec256<float> shifted, hn::Vec256<float> s,
                                       float largest) {
  const __m256i i = _mm256_castps_si256(shifted.raw);
  const auto* const table = reinterpret_cast<const __m256i*>(kExp2Table<float>.data());
  const __m256i entry = _mm256_permutex2var_epi32(table[0], i, table[1]);
  const __mmask8 in_range = _mm256_cmp_ps_mask(s.raw, _mm256_set1_ps(largest), _CMP_LE_OQ);
  return hn::Vec256<float>{_mm256_castsi256_ps(
      _mm256_maskz_add_epi32(in_range, entry, _mm256_slli_epi32(i, kTableShift<float>)))};
}

// Replaces s by 2^-s in kCount vectors: s = k + q with k in sixteenths, 2^-s = 2^-k 2^-q.
template <int kCount, class D, class V = hn::Vec<D>>
HWY_INLINE void Exp2ByTable(D d, V (&s)[kCount]) {
  using T = hn::TFromD<D>;
  using P = Exp2TablePolynomial<T>;
  constexpr int kLast = static_cast<int>(std::size(P::kTerms)) - 1;
  // The low bits of shifter - s are 16 (bias - k).
  const V shifter =
      hn::Set(d, T(3) * T(std::uint64_t{1} << (kTableShift<T> - 1)) + T(kExponentBias<T>));
  V power[kCount], p[kCount];
  for (int i = 0; i < kCount; ++i) {
    power[i] = Power16th(hn::Sub(shifter, s[i]), s[i], T(kExponentBias<T> - 1));
    s[i] = FractionOf16th(s[i]);
    p[i] = hn::Set(d, P::kTerms[kLast]);
  }
  HWY_UNROLL(8) for (int c = kLast - 1; c >= 0; --c) {
    for (int i = 0; i < kCount; ++i) p[i] = hn::MulAdd(p[i], s[i], hn::Set(d, P::kTerms[c]));
  }
  for (int i = 0; i < kCount; ++i) {
    s[i] = hn::MulAdd(hn::Mul(power[i], s[i]), p[i], power[i]);
  }
}

#endif  // HWY_TARGET <= HWY_AVX3

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_EXP2_TABLE_INL_H_
