// SPDX-License-Identifier: Apache-2.0
#include "kernels/dense_query/dense_query.h"

#include <cstddef>
#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/dense_query/dense_query.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/gp_query/exp2_negative-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Vectors of queries at a time: as many as keep their sums and polynomials in registers. A tile is
// a multiple of it for every vector length.
template <typename T>
constexpr int kWidth = HWY_MAX_BYTES >= 64 && sizeof(T) == 8 ? 6 : 3;

template <typename T>
void Covariances(int n_queries, int n, int dim, const T* HWY_RESTRICT queries,
                 const T* HWY_RESTRICT points, T* HWY_RESTRICT e) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const std::size_t lanes = hn::Lanes(d), row = n_queries;
  for (std::size_t first = 0; first < row; first += kWidth<T> * lanes) {
    // 1, or NaN where a query is not finite: the power of that may be anything.
    V one[kWidth<T>];
    for (int v = 0; v < kWidth<T>; ++v) {
      one[v] = hn::Set(d, T(1));
      for (int k = 0; k < dim; ++k) {
        const V q = hn::Load(d, queries + k * row + first + v * lanes);
        one[v] = hn::MulAdd(hn::Zero(d), q, one[v]);
      }
    }
    const T* HWY_RESTRICT point = points;
    T* HWY_RESTRICT out = e + first;
    for (int i = 0; i < n; ++i, point += dim, out += row) {
      V s[kWidth<T>];
      for (V& sum : s) sum = hn::Zero(d);
      const T* HWY_RESTRICT query = queries + first;
      for (int k = 0; k < dim; ++k, query += row) {
        const V c = hn::Set(d, point[k]);
        for (int v = 0; v < kWidth<T>; ++v) {
          const V t = hn::Sub(hn::Load(d, query + v * lanes), c);
          s[v] = hn::MulAdd(t, t, s[v]);
        }
      }
      Exp2Negative(d, s);
      for (int v = 0; v < kWidth<T>; ++v) hn::Store(hn::Mul(one[v], s[v]), d, out + v * lanes);
    }
  }
}

template <typename T>
void Variances(int n_queries, int n, double signal_variance, const T* HWY_RESTRICT v,
               double* HWY_RESTRICT variance) {
  const hn::ScalableTag<double> d;
  const hn::Rebind<T, decltype(d)> d_in;
  using V = hn::Vec<decltype(d)>;
  const std::size_t lanes = hn::Lanes(d), row = n_queries;
  constexpr int kSums = kWidth<double>;
  for (std::size_t first = 0; first < row; first += kSums * lanes) {
    V left[kSums];
    for (V& value : left) value = hn::Set(d, signal_variance);
    const T* HWY_RESTRICT in = v + first;
    for (int i = 0; i < n; ++i, in += row) {
      for (int k = 0; k < kSums; ++k) {
        V x;
        if constexpr (std::is_same_v<T, double>) {
          x = hn::Load(d, in + k * lanes);
        } else {
          x = hn::PromoteTo(d, hn::Load(d_in, in + k * lanes));
        }
        left[k] = hn::NegMulAdd(x, x, left[k]);
      }
    }
    for (int k = 0; k < kSums; ++k) {
      // Not Max, which would hide a NaN.
      const V clamped = hn::IfThenElse(hn::Lt(left[k], hn::Zero(d)), hn::Zero(d), left[k]);
      hn::Store(clamped, d, variance + first + k * lanes);
    }
  }
}

void CovariancesDouble(int n_queries, int n, int dim, const double* queries, const double* points,
                       double* e) {
  Covariances(n_queries, n, dim, queries, points, e);
}
void CovariancesFloat(int n_queries, int n, int dim, const float* queries, const float* points,
                      float* e) {
  Covariances(n_queries, n, dim, queries, points, e);
}
void VariancesDouble(int n_queries, int n, double signal_variance, const double* v,
                     double* variance) {
  Variances(n_queries, n, signal_variance, v, variance);
}
void VariancesFloat(int n_queries, int n, double signal_variance, const float* v,
                    double* variance) {
  Variances(n_queries, n, signal_variance, v, variance);
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(CovariancesDouble);
HWY_EXPORT(CovariancesFloat);
HWY_EXPORT(VariancesDouble);
HWY_EXPORT(VariancesFloat);

void QueryCovariances(int n_queries, int n, int dim, const double* queries, const double* points,
                      double* e) {
  HWY_DYNAMIC_DISPATCH(CovariancesDouble)(n_queries, n, dim, queries, points, e);
}
void QueryCovariances(int n_queries, int n, int dim, const float* queries, const float* points,
                      float* e) {
  HWY_DYNAMIC_DISPATCH(CovariancesFloat)(n_queries, n, dim, queries, points, e);
}
void QueryVariances(int n_queries, int n, double signal_variance, const double* v,
                    double* variance) {
  HWY_DYNAMIC_DISPATCH(VariancesDouble)(n_queries, n, signal_variance, v, variance);
}
void QueryVariances(int n_queries, int n, double signal_variance, const float* v,
                    double* variance) {
  HWY_DYNAMIC_DISPATCH(VariancesFloat)(n_queries, n, signal_variance, v, variance);
}

}  // namespace downpour
#endif  // HWY_ONCE
