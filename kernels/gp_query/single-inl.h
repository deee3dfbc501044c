// SPDX-License-Identifier: Apache-2.0

// One query alone: vectors hold points, then rows of W e, in the place of lanes. Every step of
// every sum is that of a lane in a tile, so that its bits are too. In Highway's current target.
#if defined(DOWNPOUR_SINGLE_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_SINGLE_INL_H_
#undef DOWNPOUR_SINGLE_INL_H_
#else
#define DOWNPOUR_SINGLE_INL_H_
#endif

#include <algorithm>
#include <cstddef>

#include "hwy/highway.h"
#include "kernels/gp_query/exp2_negative-inl.h"
#include "kernels/gp_query/gp_query.h"
#include "kernels/gp_query/triangle_layout.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// The tag of a panel's rows, or part of them, and that of a single number.
template <typename T>
using RowTag = hn::CappedTag<T, kRowBlock>;
template <typename T>
using OneTag = hn::CappedTag<T, 1>;

// a b + c and c - a b, rounded as the vectors of this target do.
template <typename T>
HWY_INLINE T MulAddOne(T a, T b, T c) {
  const OneTag<T> d;
  return hn::GetLane(hn::MulAdd(hn::Set(d, a), hn::Set(d, b), hn::Set(d, c)));
}
template <typename T>
HWY_INLINE T NegMulAddOne(T a, T b, T c) {
  const OneTag<T> d;
  return hn::GetLane(hn::NegMulAdd(hn::Set(d, a), hn::Set(d, b), hn::Set(d, c)));
}

// e of all points (n_padded) for one query, whose D numbers are `step` apart.
template <typename T>
HWY_INLINE void SingleCovariances(const GpFactorT<T>& f, const T* HWY_RESTRICT query,
                                  std::size_t step, T* HWY_RESTRICT e) {
  const RowTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const hn::RebindToSigned<decltype(d)> d_index;
  const auto stride = hn::Mul(hn::Iota(d_index, 0), hn::Set(d_index, f.dim));
  const T* point = f.inputs.data();
  for (int i = 0; i < f.n_padded; i += lanes, point += lanes * f.dim) {
    V s = hn::Zero(d);
    for (int k = 0; k < f.dim; ++k) {
      const V t = hn::Sub(hn::Set(d, query[k * step]), hn::GatherIndex(d, point + k, stride));
      s = hn::MulAdd(t, t, s);
    }
    hn::Store(s, d, e + i);
  }
  // Several at a time: one polynomial alone waits for the latency of its own multiply-adds.
  constexpr int kAtOnce = 4;
  int i = 0;
  for (; i + kAtOnce * lanes <= f.n_padded; i += kAtOnce * lanes) {
    V s[kAtOnce];
    for (int v = 0; v < kAtOnce; ++v) s[v] = hn::Load(d, e + i + v * lanes);
    Exp2Negative(d, s);
    for (int v = 0; v < kAtOnce; ++v) hn::Store(s[v], d, e + i + v * lanes);
  }
  for (; i < f.n_padded; i += lanes) {
    V s[1] = {hn::Load(d, e + i)};
    Exp2Negative(d, s);
    hn::Store(s[0], d, e + i);
  }
}

// From e to e'.
template <typename T>
HWY_INLINE void SingleDeflation(const GpFactorT<T>& f, T* HWY_RESTRICT e) {
  const T* v = f.deflation.data();
  for (int i = 0; i < f.n_padded; ++i, v += kRowBlock) {
    T left = e[i];
    for (int k = 0; k < std::min(i, kRowBlock); ++k) left = NegMulAddOne(v[k], e[k], left);
    e[i] = i < kRowBlock ? left * v[i] : left;
  }
}

// Adds columns [first, end) to kPanels panels whose values begin at w[p], counted from column 0.
template <int kPanels, typename T>
HWY_INLINE void AddColumns(const T* const (&w)[kPanels], int first, int end,
                           const T* HWY_RESTRICT e, T* HWY_RESTRICT rows) {
  const RowTag<T> d;
  using V = hn::Vec<decltype(d)>;
  constexpr int kParts = kRowBlock / static_cast<int>(hn::MaxLanes(RowTag<T>()));
  const int lanes = static_cast<int>(hn::Lanes(d));
  V sum[kPanels][kParts];
  for (int p = 0; p < kPanels; ++p) {
    for (int q = 0; q < kParts; ++q) sum[p][q] = hn::Load(d, rows + p * kRowBlock + q * lanes);
  }
  for (int j = first; j < end; ++j) {
    const V c = hn::Set(d, e[j]);
    for (int p = 0; p < kPanels; ++p) {
      for (int q = 0; q < kParts; ++q) {
        sum[p][q] = hn::MulAdd(hn::Load(d, w[p] + j * kRowBlock + q * lanes), c, sum[p][q]);
      }
    }
  }
  for (int p = 0; p < kPanels; ++p) {
    for (int q = 0; q < kParts; ++q) hn::Store(sum[p][q], d, rows + p * kRowBlock + q * lanes);
  }
}

// Adds a chunk to its rows of W e: four panels at a time through the columns that they share.
template <typename T>
HWY_INLINE void AddChunkToRows(const TriangleChunk& chunk, const T* w, const T* HWY_RESTRICT e,
                               T* HWY_RESTRICT rows) {
  constexpr int kPanels = 4;
  int row = chunk.row;
  for (; row + kPanels * kRowBlock <= chunk.end_row; row += kPanels * kRowBlock) {
    const T* panel[kPanels];
    for (int p = 0; p < kPanels; ++p) {
      panel[p] = w;
      w += kRowBlock * chunk.Columns(row + p * kRowBlock);
    }
    const int shared = chunk.Columns(row);
    AddColumns(panel, 0, shared, e, rows + (row - chunk.row));
    for (int p = 1; p < kPanels; ++p) {
      const T* const one[1] = {panel[p]};
      AddColumns(one, shared, chunk.Columns(row + p * kRowBlock), e,
                 rows + (row - chunk.row) + p * kRowBlock);
    }
  }
  for (; row < chunk.end_row; row += kRowBlock) {
    const T* const one[1] = {w};
    AddColumns(one, 0, chunk.Columns(row), e, rows + (row - chunk.row));
    w += kRowBlock * chunk.Columns(row);
  }
}

// Variance, not clamped. `rows` has room for a chunk's rows.
template <typename T>
HWY_INLINE T SingleVariance(const GpFactorT<T>& f, const T* HWY_RESTRICT e, T mean,
                            T* HWY_RESTRICT rows) {
  T variance = 0;
  ForEachChunk(f.n_padded, [&](const TriangleChunk& chunk) {
    const int n_rows = chunk.end_row - chunk.row;
    if (chunk.column == 0) std::fill_n(rows, n_rows, T(0));
    AddChunkToRows(chunk, f.triangle.data() + chunk.offset, e + chunk.column, rows);
    if (chunk.column + chunk.Columns(chunk.end_row - kRowBlock) < chunk.end_row) return;
    int r = 0;
    if (chunk.row == 0) {
      double start = f.signal_variance + (static_cast<double>(mean) - static_cast<double>(mean));
      for (; r < kRowBlock; ++r) start = NegMulAddOne<double>(rows[r], rows[r], start);
      variance = static_cast<T>(start);
    }
    for (; r < n_rows; ++r) variance = NegMulAddOne(rows[r], rows[r], variance);
  });
  return variance;
}

// Mean and, unless variance is nullptr, clamped variance of one query, whose D numbers
// s_d x_d - c_d are `step` apart. `e` has room for n_padded numbers, `rows` for a chunk's rows;
// both are aligned.
template <typename T>
HWY_NOINLINE void QuerySingle(const GpFactorT<T>& f, const T* HWY_RESTRICT query, std::size_t step,
                              T* HWY_RESTRICT e, T* HWY_RESTRICT rows, double* HWY_RESTRICT mean,
                              double* HWY_RESTRICT variance) {
  SingleCovariances(f, query, step, e);
  if (!f.deflation.empty()) SingleDeflation(f, e);
  T sum = 0;
  for (int k = 0; k < f.dim; ++k) sum = MulAddOne(T(0), query[k * step], sum);
  for (int i = 0; i < f.n_padded; ++i) sum = MulAddOne(f.weights[i], e[i], sum);
  *mean = sum;
  if (variance == nullptr) return;
  const double v = SingleVariance(f, e, sum, rows);
  *variance = v < 0 ? 0 : v;
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_SINGLE_INL_H_
