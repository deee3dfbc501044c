// SPDX-License-Identifier: Apache-2.0

// A group of queries of a tile: its scratch, its inputs and its results, in Highway's current
// target.
#if defined(DOWNPOUR_GROUP_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_GROUP_INL_H_
#undef DOWNPOUR_GROUP_INL_H_
#else
#define DOWNPOUR_GROUP_INL_H_
#endif

#include <cstddef>
#include <type_traits>

#include "hwy/highway.h"
#include "kernels/gp_query/gp_query.h"
#include "kernels/gp_query/triangle_layout.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Scratch of `lanes` queries; its rows lie together.
template <typename T>
struct Group {
  T* queries;   // D rows: s_d x_d - c_d
  T* e;         // n_padded rows, e or e'
  T* rows;      // kChunkRows rows of W e, incomplete between chunks
  T* mean;      // 1 row
  T* variance;  // 1 row

  static std::size_t Rows(const GpFactorT<T>& f) { return f.dim + f.n_padded + kChunkRows + 2; }
  Group(const GpFactorT<T>& f, std::size_t lanes, T* scratch)
      : queries(scratch),
        e(queries + f.dim * lanes),
        rows(e + f.n_padded * lanes),
        mean(rows + kChunkRows * lanes),
        variance(mean + lanes) {}
};

// Vectors of T as double and back.
template <typename T, class D>
HWY_INLINE hn::Vec<D> LoadDouble(D d, const T* from) {
  if constexpr (std::is_same_v<T, double>) {
    return hn::Load(d, from);
  } else {
    return hn::PromoteTo(d, hn::Load(hn::Rebind<T, D>(), from));
  }
}
template <typename T, class D>
HWY_INLINE void StoreDouble(hn::Vec<D> value, D d, T* to) {
  if constexpr (std::is_same_v<T, double>) {
    hn::Store(value, d, to);
  } else {
    hn::Store(hn::DemoteTo(hn::Rebind<T, D>(), value), hn::Rebind<T, D>(), to);
  }
}

// The variance after the first panel's rows of W e, in double: with pivoted points they hold most
// of |W e|^2, and what they leave is small enough for float to go on with. NaN where the mean is
// not finite.
template <class D, typename T>
HWY_INLINE void StartVariance(D d, double signal_variance, const Group<T>& group, int lanes) {
  for (int lane = 0; lane < lanes; lane += static_cast<int>(hn::Lanes(d))) {
    const auto mean = LoadDouble(d, group.mean + lane);
    auto variance = hn::Add(hn::Set(d, signal_variance), hn::Sub(mean, mean));
    for (int r = 0; r < kRowBlock; ++r) {
      const auto row = LoadDouble(d, group.rows + r * lanes + lane);
      variance = hn::NegMulAdd(row, row, variance);
    }
    StoreDouble(variance, d, group.variance + lane);
  }
}

// s_d x_d - c_d in double, rounded to T.
template <class D, typename T>
HWY_INLINE void ScaleQueries(D d, const GpFactorT<T>& f, const double* HWY_RESTRICT x, int lanes,
                             T* HWY_RESTRICT queries) {
  const hn::Rebind<T, decltype(d)> d_out;
  for (int k = 0; k < f.dim; ++k) {
    const auto s = hn::Set(d, f.scale[k]), c = hn::Set(d, f.centre[k]);
    for (int lane = 0; lane < lanes; lane += static_cast<int>(hn::Lanes(d))) {
      const auto q = hn::MulSub(s, hn::Load(d, x + k * kTileLanes + lane), c);
      if constexpr (std::is_same_v<T, double>) {
        hn::Store(q, d, queries + k * lanes + lane);
      } else {
        // Highway's scalar target demotes infinity to the largest float: make it NaN.
        const auto finite = hn::Add(q, hn::Sub(q, q));
        hn::Store(hn::DemoteTo(d_out, finite), d_out, queries + k * lanes + lane);
      }
    }
  }
}

// Means and clamped variances in double.
template <class D, typename T>
HWY_INLINE void WriteResults(D d, const Group<T>& group, int lanes, double* HWY_RESTRICT mean,
                             double* HWY_RESTRICT variance) {
  for (int lane = 0; lane < lanes; lane += static_cast<int>(hn::Lanes(d))) {
    hn::Store(LoadDouble(d, group.mean + lane), d, mean + lane);
    if (variance == nullptr) continue;
    // The operands' order lets a NaN through: Max(NaN, 0) would hide a lane that is not finite.
    const auto v = LoadDouble(d, group.variance + lane);
    hn::Store(hn::IfThenElse(hn::Lt(v, hn::Zero(d)), hn::Zero(d), v), d, variance + lane);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_GROUP_INL_H_
