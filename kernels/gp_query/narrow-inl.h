// SPDX-License-Identifier: Apache-2.0

// One query alone, in Highway's current target: vectors hold points and rows of W in the place of
// queries. Every value comes from the same operations in the same order as in a group of queries,
// so that its bits are the same.
#if defined(DOWNPOUR_NARROW_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_NARROW_INL_H_
#undef DOWNPOUR_NARROW_INL_H_
#else
#define DOWNPOUR_NARROW_INL_H_
#endif

#include <cstddef>
#include <type_traits>

#include "hwy/highway.h"
#include "kernels/gp_query/deflation-inl.h"
#include "kernels/gp_query/exp2_negative-inl.h"
#include "kernels/gp_query/gp_query.h"
#include "kernels/gp_query/group-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// A block of points or rows: kBlockVectors vectors.
template <typename T>
using BlockTag = hn::CappedTag<T, kRowBlock>;
template <typename T>
constexpr int kBlockVectors = kRowBlock / static_cast<int>(hn::MaxLanes(BlockTag<T>()));

// e of kBlocks blocks of points.
template <int kBlocks, typename T>
HWY_INLINE void NarrowCovariances(int dim, const T* HWY_RESTRICT inputs,
                                  const T* HWY_RESTRICT query, T* HWY_RESTRICT e) {
  const BlockTag<T> d;
  constexpr int kVectors = kBlocks * kBlockVectors<T>;
  constexpr int kLanes = kRowBlock / kBlockVectors<T>;
  hn::Vec<BlockTag<T>> s[kVectors];
  for (int v = 0; v < kVectors; ++v) s[v] = hn::Zero(d);
  for (int k = 0; k < dim; ++k) {
    const auto q = hn::Set(d, query[k]);
    for (int v = 0; v < kVectors; ++v) {
      const int block = v / kBlockVectors<T>, part = v % kBlockVectors<T>;
      const T* const c = inputs + (block * dim + k) * kRowBlock + part * kLanes;
      const auto t = hn::Sub(q, hn::Load(d, c));
      s[v] = hn::MulAdd(t, t, s[v]);
    }
  }
  Exp2Negative(d, s);
  for (int v = 0; v < kVectors; ++v) hn::StoreU(s[v], d, e + v * kLanes);
}

// From e to e'.
template <typename T>
HWY_INLINE void NarrowDeflate(const GpFactorT<T>& f, T* HWY_RESTRICT e) {
  const hn::CappedTag<T, 1> d_one;
  const T* v = f.deflation.data();
  SolveFirst<1>(d_one, v, e);
  const BlockTag<T> d;
  constexpr int kLanes = kRowBlock / kBlockVectors<T>;
  for (int first = kRowBlock; first < f.n_padded; first += kRowBlock) {
    v += kRowBlock * kRowBlock;
    for (int i = 0; i < kRowBlock; i += kLanes) {
      auto left = hn::LoadU(d, e + first + i);
      for (int k = 0; k < kRowBlock; ++k) {
        left = hn::NegMulAdd(hn::Load(d, v + k * kRowBlock + i), hn::Set(d, e[k]), left);
      }
      hn::StoreU(left, d, e + first + i);
    }
  }
}

template <typename T>
HWY_NOINLINE void NarrowCovariancesAndMean(const GpFactorT<T>& f, const T* HWY_RESTRICT query,
                                           T* HWY_RESTRICT e, T* HWY_RESTRICT mean) {
  constexpr int kBlocks = HWY_MAX_BYTES >= 64 ? 4 : 2;
  int first = 0;
  for (; first + kBlocks * kRowBlock <= f.n_padded; first += kBlocks * kRowBlock) {
    NarrowCovariances<kBlocks>(f.dim, f.inputs.data() + PointOffset(first, 0, f.dim), query,
                               e + first);
  }
  for (; first < f.n_padded; first += kRowBlock) {
    NarrowCovariances<1>(f.dim, f.inputs.data() + PointOffset(first, 0, f.dim), query, e + first);
  }
  if (!f.deflation.empty()) NarrowDeflate(f, e);
  const hn::CappedTag<T, 1> d;
  auto sum = hn::Zero(d);
  for (int k = 0; k < f.dim; ++k) sum = hn::MulAdd(hn::Zero(d), hn::Load(d, query + k), sum);
  for (int i = 0; i < f.n_padded; ++i) {
    sum = hn::MulAdd(hn::Load(d, f.weights.data() + i), hn::Load(d, e + i), sum);
  }
  hn::Store(sum, d, mean);
}

// Adds kPanels panels of a chunk, the first of rows from `row` on, from the chunk's column `begin`
// on to their rows of W e. The panels side by side hide the latency of the multiply-add; at a
// diagonal they end one after the other.
template <int kPanels, typename T>
HWY_INLINE void NarrowPanels(const TriangleChunk& chunk, int row, const T* HWY_RESTRICT w,
                             int begin, const T* HWY_RESTRICT e, T* HWY_RESTRICT rows) {
  if constexpr (kPanels > 0) {
    const BlockTag<T> d;
    constexpr int kLanes = kRowBlock / kBlockVectors<T>;
    const T* panel[kPanels];
    hn::Vec<BlockTag<T>> sum[kPanels][kBlockVectors<T>];
    const T* next = w;
    for (int p = 0; p < kPanels; ++p) {
      panel[p] = next;
      next += kRowBlock * chunk.Columns(row + p * kRowBlock);
      for (int v = 0; v < kBlockVectors<T>; ++v) {
        T* const kept = rows + p * kRowBlock + v * kLanes;
        sum[p][v] = chunk.column + begin == 0 ? hn::Zero(d) : hn::LoadU(d, kept);
      }
    }
    const int end = chunk.Columns(row);
    for (int j = begin; j < end; ++j) {
      const auto ej = hn::Set(d, e[j]);
      for (int p = 0; p < kPanels; ++p) {
        for (int v = 0; v < kBlockVectors<T>; ++v) {
          const auto wj = hn::Load(d, panel[p] + j * kRowBlock + v * kLanes);
          sum[p][v] = hn::MulAdd(wj, ej, sum[p][v]);
        }
      }
    }
    for (int p = 0; p < kPanels; ++p) {
      for (int v = 0; v < kBlockVectors<T>; ++v) {
        hn::StoreU(sum[p][v], d, rows + p * kRowBlock + v * kLanes);
      }
    }
    if (chunk.Columns(row + (kPanels - 1) * kRowBlock) > end) {
      NarrowPanels<kPanels - 1>(chunk, row + kRowBlock, w + kRowBlock * end, end, e,
                                rows + kRowBlock);
    }
  }
}

// Adds a chunk to the rows of W e of one query; `w` holds the chunk, `e` starts at its column.
template <typename T>
HWY_NOINLINE void NarrowChunk(const TriangleChunk& chunk, const T* HWY_RESTRICT w,
                              const T* HWY_RESTRICT e, T* HWY_RESTRICT rows) {
  static_assert(kChunkRows % (4 * kRowBlock) == 0);
  int row = chunk.row;
  const auto add = [&](auto panels) {
    NarrowPanels<panels>(chunk, row, w, 0, e, rows + (row - chunk.row));
    for (int p = 0; p < panels; ++p, row += kRowBlock) w += kRowBlock * chunk.Columns(row);
  };
  if (HWY_MAX_BYTES >= 64 && chunk.end_row - row == 8 * kRowBlock) {
    return add(std::integral_constant<int, 8>());
  }
  while (chunk.end_row - row >= 4 * kRowBlock) add(std::integral_constant<int, 4>());
  while (chunk.end_row - row >= 2 * kRowBlock) add(std::integral_constant<int, 2>());
  if (chunk.end_row - row >= kRowBlock) add(std::integral_constant<int, 1>());
}

// Takes the squares of a chunk's complete rows of W e from the variance of one query.
template <typename T>
HWY_INLINE void SubtractRows(const GpFactorT<T>& f, const TriangleChunk& chunk,
                             const Group<T>& query) {
  const hn::CappedTag<T, 1> d;
  int row = chunk.row;
  if (row == 0) {
    StartVariance(hn::CappedTag<double, 1>(), f.signal_variance, query, 1);
    row += kRowBlock;
  }
  auto left = hn::Load(d, query.variance);
  for (; row < chunk.end_row; ++row) {
    const auto value = hn::Load(d, query.rows + (row - chunk.row));
    left = hn::NegMulAdd(value, value, left);
  }
  hn::Store(left, d, query.variance);
}

// Up to so many queries are cheaper one by one: one more in wide vectors while the triangle stays
// in the second-level cache, as each reads it again; none when it is so long that only the memory
// counts, which a group reads more evenly (n = 2560 in double: 1.3 ms, not 1.5).
template <typename T>
HWY_INLINE int MostNarrow(const GpFactorT<T>& f) {
  const std::size_t mebibytes = (f.triangle.size() * sizeof(T)) >> 20;
  if (mebibytes >= 16) return 0;
  return (std::is_same_v<T, double> ? 1 : 2) + (HWY_MAX_BYTES >= 64 && mebibytes == 0);
}

// A few queries one by one.
template <typename T>
void QueryOneByOne(const GpFactorT<T>& f, int n_lanes, const double* HWY_RESTRICT x,
                   T* HWY_RESTRICT scratch, double* HWY_RESTRICT mean,
                   double* HWY_RESTRICT variance) {
  const hn::CappedTag<double, 1> d;
  const auto query_at = [&](int lane) {
    return Group<T>(f, 1, scratch + Group<T>::Rows(f) * lane);
  };
  for (int lane = 0; lane < n_lanes; ++lane) {
    const Group<T> query = query_at(lane);
    ScaleQueries(d, f, x + lane, 1, query.queries);
    NarrowCovariancesAndMean(f, query.queries, query.e, query.mean);
  }
  if (variance != nullptr) {
    ForEachChunk(f.n_padded, [&](const TriangleChunk& chunk) {
      for (int lane = 0; lane < n_lanes; ++lane) {
        const Group<T> query = query_at(lane);
        NarrowChunk(chunk, f.triangle.data() + chunk.offset, query.e + chunk.column, query.rows);
        if (chunk.end_column == chunk.end_row) SubtractRows(f, chunk, query);
      }
    });
  }
  for (int lane = 0; lane < n_lanes; ++lane) {
    WriteResults(d, query_at(lane), 1, mean + lane,
                 variance == nullptr ? nullptr : variance + lane);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_NARROW_INL_H_
