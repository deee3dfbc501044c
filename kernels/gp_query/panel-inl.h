// SPDX-License-Identifier: Apache-2.0

// The inner loop of W e for one panel of the packed triangle, in Highway's current target.
#if defined(DOWNPOUR_PANEL_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_PANEL_INL_H_
#undef DOWNPOUR_PANEL_INL_H_
#else
#define DOWNPOUR_PANEL_INL_H_
#endif

#include "hwy/highway.h"
#include "kernels/gp_query/triangle_layout.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// 32 registers hold eight rows of three vectors and their operands, 16 hold four. One vector alone
// needs eight rows to hide the latency of the multiply-add.
constexpr bool kManyRegisters = HWY_MAX_BYTES >= 64;
template <int kWidth>
constexpr int kRows = kManyRegisters || kWidth == 1 ? 8 : 4;

// What is read next, brought into the second-level cache: a line at every `step` elements.
template <typename T>
struct Fetch {
  const T* from;
  int step;
};

// Keeps a value in a register here and instructions in their order, where three vectors need all of
// 16 registers. GCC would otherwise load c again for every row (26 loads instead of 14 for two
// columns of 24 multiply-adds, where a cycle has two of each at most) or, mixing columns, spill
// sums: 14 % of the whole query at n = 320.
template <int kWidth, class V>
HWY_INLINE void Pin(V& value) {
#if HWY_TARGET == HWY_AVX2 && HWY_COMPILER_GCC
  if constexpr (kWidth == 3) asm volatile("" : "+x"(value.raw));
#else
  static_cast<void>(value);
#endif
}

// Adds one column to rows from kFirstRow on.
template <int kWidth, int kFirstRow, class V, typename T>
HWY_INLINE void AddColumn(const T* HWY_RESTRICT wj, const T* HWY_RESTRICT ej,
                          V (&row)[kRows<kWidth>][kWidth]) {
  const hn::ScalableTag<T> d;
  V c[kWidth];
  for (int v = 0; v < kWidth; ++v) {
    c[v] = hn::Load(d, ej + v * hn::Lanes(d));
    Pin<kWidth>(c[v]);
  }
  HWY_UNROLL(8) for (int r = kFirstRow > 0 ? kFirstRow : 0; r < kRows<kWidth>; ++r) {
    const V wr = hn::Set(d, wj[r]);
    for (int v = 0; v < kWidth; ++v) {
      row[r][v] = hn::MulAdd(wr, c[v], row[r][v]);
      Pin<kWidth>(row[r][v]);
    }
  }
}

// Adds the block at the diagonal from its column kColumn on, without the zeros above the diagonal,
// to rows from kPart on.
template <int kWidth, int kPart, int kColumn = 0, class V, typename T>
HWY_INLINE void AddDiagonal(const T* HWY_RESTRICT wj, const T* HWY_RESTRICT ej,
                            V (&row)[kRows<kWidth>][kWidth]) {
  if constexpr (kColumn < kPart + kRows<kWidth>) {
    AddColumn<kWidth, kColumn - kPart>(wj, ej, row);
    const hn::ScalableTag<T> d;
    AddDiagonal<kWidth, kPart, kColumn + 1>(wj + kRowBlock, ej + kWidth * hn::Lanes(d), row);
  }
}

// AddPanel for its rows from kPart on.
template <int kWidth, bool kFetchAll, int kPart = 0, typename T>
HWY_INLINE void AddPanelRows(const T* HWY_RESTRICT w, int n_columns, bool begins_rows,
                             bool diagonal, const Fetch<T> (&fetch)[2], const T* HWY_RESTRICT e,
                             T* HWY_RESTRICT rows, T* HWY_RESTRICT variance) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const size_t lanes = hn::Lanes(d);
  V row[kRows<kWidth>][kWidth];
  T* HWY_RESTRICT kept = rows + kPart * kWidth * lanes;
  for (int r = 0; r < kRows<kWidth>; ++r) {
    for (int v = 0; v < kWidth; ++v) {
      row[r][v] = begins_rows ? hn::Zero(d) : hn::Load(d, kept + (r * kWidth + v) * lanes);
    }
  }
  const T* HWY_RESTRICT wj = w + kPart;
  const T* HWY_RESTRICT ej = e;
  const T* next[2] = {fetch[0].from, fetch[1].from};
  const int n_full = diagonal ? n_columns - kRowBlock : n_columns;
  for (int j = 0; j < n_full; j += 2) {
    HWY_UNROLL(2) for (int odd = 0; odd < 2; ++odd) {
      constexpr int kLine = 64 / sizeof(T);
      if (kFetchAll && odd * kRowBlock % kLine == 0) {
        __builtin_prefetch(wj + odd * kRowBlock + 16 * kLine, 0, 3);
      }
      if (kFetchAll || (kManyRegisters && odd == 0)) {
        __builtin_prefetch(next[odd], 0, 2);
        next[odd] += fetch[odd].step;
      }
      AddColumn<kWidth, 0>(wj + odd * kRowBlock, ej + odd * kWidth * lanes, row);
    }
    wj += 2 * kRowBlock;
    ej += 2 * kWidth * lanes;
  }
  if (diagonal) AddDiagonal<kWidth, kPart>(wj, ej, row);
  for (int v = 0; v < kWidth; ++v) {
    if (diagonal && variance != nullptr) {
      V left = hn::Load(d, variance + v * lanes);
      for (int r = 0; r < kRows<kWidth>; ++r) left = hn::NegMulAdd(row[r][v], row[r][v], left);
      hn::Store(left, d, variance + v * lanes);
    } else {
      for (int r = 0; r < kRows<kWidth>; ++r) {
        hn::Store(row[r][v], d, kept + (r * kWidth + v) * lanes);
      }
    }
  }
}

// Adds a panel's n_columns columns, an even number, to its rows of W e. A panel that ends at the
// diagonal completes them: their squares are taken from the variance unless that is nullptr. With
// 32 registers, makes a step of the first fetch at every other column, as a line needs more than
// one to come. If kFetchAll, makes steps of both and brings the panel itself into the first-level
// cache, 1 KiB ahead.
template <int kWidth, bool kFetchAll, typename T>
HWY_INLINE void AddPanel(const T* HWY_RESTRICT w, int n_columns, bool begins_rows, bool diagonal,
                         const Fetch<T> (&fetch)[2], const T* HWY_RESTRICT e, T* HWY_RESTRICT rows,
                         T* HWY_RESTRICT variance) {
  AddPanelRows<kWidth, kFetchAll>(w, n_columns, begins_rows, diagonal, fetch, e, rows, variance);
  if constexpr (kRows<kWidth> < kRowBlock) {
    AddPanelRows<kWidth, kFetchAll, kRows<kWidth>>(w, n_columns, begins_rows, diagonal, fetch, e,
                                                   rows, variance);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_PANEL_INL_H_
