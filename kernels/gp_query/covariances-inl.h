// SPDX-License-Identifier: Apache-2.0

// Covariances of a group of queries with all points, and the mean, in Highway's current target.
#if defined(DOWNPOUR_COVARIANCES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_COVARIANCES_INL_H_
#undef DOWNPOUR_COVARIANCES_INL_H_
#else
#define DOWNPOUR_COVARIANCES_INL_H_
#endif

#include <cstddef>

#include "hwy/highway.h"
#include "kernels/gp_query/covariance_passes.h"
#include "kernels/gp_query/deflation-inl.h"
#include "kernels/gp_query/exp2_negative-inl.h"
#include "kernels/gp_query/gp_query.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Squared scaled distances of kRowBlock points. kDim = 0: D at run time.
template <int kWidth, int kDim, typename T>
HWY_INLINE void SquaredDistances(int run_time_dim, const T* HWY_RESTRICT input,
                                 const T* HWY_RESTRICT queries, T* HWY_RESTRICT out) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const size_t lanes = hn::Lanes(d);
  const int dim = kDim > 0 ? kDim : run_time_dim;
  for (int i = 0; i < kRowBlock; ++i, out += kWidth * lanes) {
    V s[kWidth];
    for (V& sum : s) sum = hn::Zero(d);
    for (int k = 0; k < dim; ++k) {
      const V c = hn::Set(d, input[k * kRowBlock + i]);
      for (int v = 0; v < kWidth; ++v) {
        const V t = hn::Sub(hn::Load(d, queries + (k * kWidth + v) * lanes), c);
        s[v] = hn::MulAdd(t, t, s[v]);
      }
    }
    for (int v = 0; v < kWidth; ++v) hn::Store(s[v], d, out + v * lanes);
  }
}

// e of every point, e' if there is a deflation, and the mean of kWidth vectors of queries, in
// passes over kRowBlock points at a time: each pass alone keeps its operands in registers.
// The passes after kLast are left out.
//   queries      D rows of kWidth vectors, s_d x_d - c_d
//   covariances  n_padded rows; mean  1 row
template <int kWidth, int kDim, CovariancePass kLast, typename T>
HWY_NOINLINE void CovariancesAndMeanOfDim(const GpFactorT<T>& f, const T* HWY_RESTRICT queries,
                                          T* HWY_RESTRICT covariances, T* HWY_RESTRICT mean) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const size_t lanes = hn::Lanes(d);
  constexpr int kAtOnce = HWY_MAX_BYTES >= 64 ? 8 : 4;  // of 32 or 16 registers
  V sum[kWidth];
  // 0 x starts the sums, so that a lane that is not finite stays so whatever the power makes of it.
  for (int v = 0; v < kWidth; ++v) {
    sum[v] = hn::Zero(d);
    for (int k = 0; k < f.dim; ++k) {
      const V q = hn::Load(d, queries + (k * kWidth + v) * lanes);
      sum[v] = hn::MulAdd(hn::Zero(d), q, sum[v]);
    }
  }
  T* e = covariances;
  for (int first = 0; first < f.n_padded; first += kRowBlock) {
    const T* const inputs = f.inputs.data() + static_cast<std::size_t>(first) * f.dim;
    SquaredDistances<kWidth, kDim>(f.dim, inputs, queries, e);
    constexpr size_t kRows = kLast >= CovariancePass::kExponentials ? kRowBlock : 0;
    for (size_t i = 0; i < kRows * kWidth * lanes; i += kAtOnce * lanes) {
      V s[kAtOnce];
      for (int v = 0; v < kAtOnce; ++v) s[v] = hn::Load(d, e + i + v * lanes);
      Exp2Negative(d, s);
      for (int v = 0; v < kAtOnce; ++v) hn::Store(s[v], d, e + i + v * lanes);
    }
    if (kLast >= CovariancePass::kDeflation && !f.deflation.empty()) {
      const T* const rows = f.deflation.data() + static_cast<std::size_t>(first) * kRowBlock;
      if (first == 0) {
        SolveFirst<kWidth>(d, rows, e);
      } else {
        SubtractExplained<kWidth>(rows, covariances, e);
      }
    }
    if constexpr (kLast < CovariancePass::kMean) {
      e += kRowBlock * kWidth * lanes;
      continue;
    }
    for (int i = 0; i < kRowBlock; ++i, e += kWidth * lanes) {
      const V w = hn::Set(d, f.weights[first + i]);
      for (int v = 0; v < kWidth; ++v) sum[v] = hn::MulAdd(w, hn::Load(d, e + v * lanes), sum[v]);
    }
  }
  for (int v = 0; v < kWidth; ++v) hn::Store(sum[v], d, mean + v * lanes);
}

// The D of the tasks at compile time.
template <int kWidth, CovariancePass kLast = CovariancePass::kMean, typename T>
HWY_INLINE void CovariancesAndMean(const GpFactorT<T>& f, const T* HWY_RESTRICT queries,
                                   T* HWY_RESTRICT covariances, T* HWY_RESTRICT mean) {
  switch (f.dim) {
    case 4:
      return CovariancesAndMeanOfDim<kWidth, 4, kLast>(f, queries, covariances, mean);
    case 6:
      return CovariancesAndMeanOfDim<kWidth, 6, kLast>(f, queries, covariances, mean);
    case 12:
      return CovariancesAndMeanOfDim<kWidth, 12, kLast>(f, queries, covariances, mean);
    default:
      return CovariancesAndMeanOfDim<kWidth, 0, kLast>(f, queries, covariances, mean);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_COVARIANCES_INL_H_
