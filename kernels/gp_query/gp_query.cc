// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_query/gp_query.h"

#include <algorithm>
#include <type_traits>

#include "kernels/gp_query/triangle_layout.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/gp_query/gp_query.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/gp_query/exp2_negative-inl.h"
#include "kernels/gp_query/panel-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// A tile is cut into groups of kWidth = 3, 2 or 1 vectors of lanes; the rows of a group lie
// together.
template <typename T>
struct Group {
  T* queries;  // D rows: s_d x_d - c_d
  T* e;        // n_padded rows
  T* rows;     // kChunkSide rows of W e, incomplete between chunks
  T* mean;     // 1 row
  T* norm;     // 1 row: |W e|^2

  static std::size_t Rows(const GpFactorT<T>& f) { return f.dim + f.n_padded + kChunkSide + 2; }
  Group(const GpFactorT<T>& f, std::size_t lanes, T* scratch)
      : queries(scratch),
        e(queries + f.dim * lanes),
        rows(e + f.n_padded * lanes),
        mean(rows + kChunkSide * lanes),
        norm(mean + lanes) {}
};

// Calls body(std::integral_constant<int, width>(), first) for the groups that `vectors` vectors are
// cut into. Groups of one, which load more than they compute, are avoided.
template <class Body>
HWY_INLINE void ForEachGroup(int vectors, const Body& body) {
  int first = 0;
  for (; vectors - first == 3 || vectors - first > 4; first += 3) {
    body(std::integral_constant<int, 3>(), first);
  }
  for (; vectors - first >= 2; first += 2) body(std::integral_constant<int, 2>(), first);
  if (vectors - first == 1) body(std::integral_constant<int, 1>(), first);
}

// Squared scaled distances of kRowBlock points. kDim = 0: D at run time.
template <int kWidth, int kDim, typename T>
HWY_INLINE void SquaredDistances(int run_time_dim, const T* HWY_RESTRICT input,
                                 const T* HWY_RESTRICT queries, T* HWY_RESTRICT out) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const size_t lanes = hn::Lanes(d);
  const int dim = kDim > 0 ? kDim : run_time_dim;
  for (int i = 0; i < kRowBlock; ++i, input += dim, out += kWidth * lanes) {
    V s[kWidth];
    for (V& sum : s) sum = hn::Zero(d);
    for (int k = 0; k < dim; ++k) {
      const V c = hn::Set(d, input[k]);
      for (int v = 0; v < kWidth; ++v) {
        const V t = hn::Sub(hn::Load(d, queries + (k * kWidth + v) * lanes), c);
        s[v] = hn::MulAdd(t, t, s[v]);
      }
    }
    for (int v = 0; v < kWidth; ++v) hn::Store(s[v], d, out + v * lanes);
  }
}

// e of every point and the mean, in three passes over kRowBlock points at a time: each pass alone
// keeps its operands in registers.
template <int kWidth, int kDim, typename T>
HWY_NOINLINE void CovariancesAndMean(const GpFactorT<T>& f, const Group<T>& group) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const size_t lanes = hn::Lanes(d);
  constexpr int kAtOnce = kManyRegisters ? 8 : 4;
  V mean[kWidth];
  // 0 x starts the sums, so that a lane that is not finite stays so whatever the power makes of it.
  for (int v = 0; v < kWidth; ++v) {
    mean[v] = hn::Zero(d);
    for (int k = 0; k < f.dim; ++k) {
      const V q = hn::Load(d, group.queries + (k * kWidth + v) * lanes);
      mean[v] = hn::MulAdd(hn::Zero(d), q, mean[v]);
    }
  }
  T* HWY_RESTRICT e = group.e;
  for (int first = 0; first < f.n_padded; first += kRowBlock) {
    const T* const inputs = f.inputs.data() + static_cast<std::size_t>(first) * f.dim;
    SquaredDistances<kWidth, kDim>(f.dim, inputs, group.queries, e);
    for (size_t i = 0; i < kRowBlock * kWidth * lanes; i += kAtOnce * lanes) {
      V s[kAtOnce];
      for (int v = 0; v < kAtOnce; ++v) s[v] = hn::Load(d, e + i + v * lanes);
      Exp2Negative(d, s);
      for (int v = 0; v < kAtOnce; ++v) hn::Store(s[v], d, e + i + v * lanes);
    }
    for (int i = 0; i < kRowBlock; ++i, e += kWidth * lanes) {
      const V w = hn::Set(d, f.weights[first + i]);
      for (int v = 0; v < kWidth; ++v) mean[v] = hn::MulAdd(w, hn::Load(d, e + v * lanes), mean[v]);
    }
  }
  for (int v = 0; v < kWidth; ++v) hn::Store(mean[v], d, group.mean + v * lanes);
}

// The D of the tasks at compile time.
template <int kWidth, typename T>
HWY_INLINE void CovariancesAndMeanOfDim(const GpFactorT<T>& f, const Group<T>& group) {
  switch (f.dim) {
    case 4:
      return CovariancesAndMean<kWidth, 4>(f, group);
    case 6:
      return CovariancesAndMean<kWidth, 6>(f, group);
    case 12:
      return CovariancesAndMean<kWidth, 12>(f, group);
    default:
      return CovariancesAndMean<kWidth, 0>(f, group);
  }
}

// Adds a chunk's panels for the group of kWidth vectors from `first` on. The groups share the
// fetching of the chunk that follows: a triangle beyond the second-level cache comes in evenly.
template <int kWidth, typename T>
HWY_INLINE void AddChunk(const TriangleChunk& chunk, const T* w, const Group<T>& group, int first,
                         int vectors) {
  const std::size_t lanes = kWidth * hn::Lanes(hn::ScalableTag<T>());
  const int step = (kRowBlock * kWidth + vectors - 1) / vectors;
  const T* fetch = w + chunk.size + chunk.size * first / vectors;
  for (int row = chunk.row; row < chunk.end_row; row += kRowBlock) {
    const int n_columns = chunk.Columns(row);
    AddPanel<kWidth>(w, n_columns, chunk.column == 0, chunk.column + n_columns == row + kRowBlock,
                     fetch, step, group.e + chunk.column * lanes,
                     group.rows + (row - chunk.row) * lanes, group.norm);
    w += kRowBlock * n_columns;
    fetch += step * n_columns;
  }
}

// s_d x_d - c_d in double, rounded to T.
template <typename T>
HWY_INLINE void ScaleQueries(const GpFactorT<T>& f, const double* HWY_RESTRICT x, int lanes,
                             T* HWY_RESTRICT queries) {
  const hn::ScalableTag<double> d;
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

// Means, and variances as signal_variance - norm, in double.
template <typename T>
HWY_INLINE void WriteResults(const GpFactorT<T>& f, const Group<T>& group, int lanes,
                             double* HWY_RESTRICT mean, double* HWY_RESTRICT variance) {
  const hn::ScalableTag<double> d;
  const hn::Rebind<T, decltype(d)> d_in;
  const auto load = [&](const T* from) {
    if constexpr (std::is_same_v<T, double>) {
      return hn::Load(d, from);
    } else {
      return hn::PromoteTo(d, hn::Load(d_in, from));
    }
  };
  for (int lane = 0; lane < lanes; lane += static_cast<int>(hn::Lanes(d))) {
    hn::Store(load(group.mean + lane), d, mean + lane);
    if (variance == nullptr) continue;
    // The operands' order lets a NaN through: Max(NaN, 0) would hide a lane that is not finite.
    const auto v = hn::Sub(hn::Set(d, f.signal_variance), load(group.norm + lane));
    hn::Store(hn::IfThenElse(hn::Lt(v, hn::Zero(d)), hn::Zero(d), v), d, variance + lane);
  }
}

template <typename T>
void QueryTile(const GpFactorT<T>& f, int n_lanes, const double* HWY_RESTRICT x,
               T* HWY_RESTRICT scratch, double* HWY_RESTRICT mean, double* HWY_RESTRICT variance) {
  const hn::ScalableTag<T> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const int vectors = (n_lanes + lanes - 1) / lanes;
  const auto group_at = [&](int width, int first) {
    return Group<T>(f, width * lanes, scratch + Group<T>::Rows(f) * first * lanes);
  };
  ForEachGroup(vectors, [&](auto width, int first) {
    const Group<T> group = group_at(width, first);
    ScaleQueries(f, x + first * lanes, width * lanes, group.queries);
    CovariancesAndMeanOfDim<width>(f, group);
    // The norm starts at 0, or NaN where the mean is not finite.
    for (int lane = 0; lane < width * lanes; lane += lanes) {
      const auto m = hn::Load(d, group.mean + lane);
      hn::Store(hn::Sub(m, m), d, group.norm + lane);
    }
  });
  if (variance != nullptr) {
    ForEachChunk(f.n_padded, [&](const TriangleChunk& chunk) {
      const T* const w = f.triangle.data() + chunk.offset;
      ForEachGroup(vectors, [&](auto width, int first) {
        AddChunk<width>(chunk, w, group_at(width, first), first, vectors);
      });
    });
  }
  ForEachGroup(vectors, [&](auto width, int first) {
    WriteResults(f, group_at(width, first), width * lanes, mean + first * lanes,
                 variance == nullptr ? nullptr : variance + first * lanes);
  });
}

void QueryTileDouble(const GpFactor& f, int n_lanes, const double* x, void* scratch, double* mean,
                     double* variance) {
  QueryTile(f, n_lanes, x, static_cast<double*>(scratch), mean, variance);
}
void QueryTileFloat(const GpFactor32& f, int n_lanes, const double* x, void* scratch, double* mean,
                    double* variance) {
  QueryTile(f, n_lanes, x, static_cast<float*>(scratch), mean, variance);
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(QueryTileDouble);
HWY_EXPORT(QueryTileFloat);

std::size_t GpQueryScratchBytes(const GpFactor& f) {
  return sizeof(double) * kTileLanes * (f.dim + f.n_padded + kChunkSide + 2);
}
std::size_t GpQueryScratchBytes(const GpFactor32& f) {
  return sizeof(float) * kTileLanes * (f.dim + f.n_padded + kChunkSide + 2);
}

void GpQueryTile(const GpFactor& factor, int n_lanes, const double* x, void* scratch, double* mean,
                 double* variance) {
  HWY_DYNAMIC_DISPATCH(QueryTileDouble)(factor, n_lanes, x, scratch, mean, variance);
}
void GpQueryTile(const GpFactor32& factor, int n_lanes, const double* x, void* scratch,
                 double* mean, double* variance) {
  HWY_DYNAMIC_DISPATCH(QueryTileFloat)(factor, n_lanes, x, scratch, mean, variance);
}

}  // namespace downpour
#endif  // HWY_ONCE
