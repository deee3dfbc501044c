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

// Adds a panel's n_columns columns, an even number, to its rows of W e, and takes the rows' squares
// from the variance once they are complete. Makes a step of each fetch at every other column: they
// take the slots of loads, and a line needs more than one column to come.
template <int kWidth, typename T>
HWY_INLINE void AddPanel(const T* HWY_RESTRICT w, int n_columns, bool begins_rows, bool ends_rows,
                         const Fetch<T> (&fetch)[2], const T* HWY_RESTRICT e, T* HWY_RESTRICT rows,
                         T* HWY_RESTRICT variance) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const size_t lanes = hn::Lanes(d);
  for (int part = 0; part < kRowBlock; part += kRows<kWidth>) {
    V row[kRows<kWidth>][kWidth];
    T* HWY_RESTRICT kept = rows + part * kWidth * lanes;
    for (int r = 0; r < kRows<kWidth>; ++r) {
      for (int v = 0; v < kWidth; ++v) {
        row[r][v] = begins_rows ? hn::Zero(d) : hn::Load(d, kept + (r * kWidth + v) * lanes);
      }
    }
    const T* HWY_RESTRICT wj = w + part;
    const T* HWY_RESTRICT ej = e;
    const T* next[2] = {fetch[0].from, fetch[1].from};
    for (int j = 0; j < n_columns; j += 2) {
      HWY_UNROLL(2) for (int odd = 0; odd < 2; ++odd) {
        // The panel itself comes into the first-level cache 1 KiB ahead, line by line.
        constexpr int kLine = 64 / sizeof(T);
        if (odd * kRowBlock % kLine == 0) {
          __builtin_prefetch(wj + odd * kRowBlock + 1024 / sizeof(T), 0, 3);
        }
        __builtin_prefetch(next[odd], 0, 2);
        V c[kWidth];
        for (int v = 0; v < kWidth; ++v) c[v] = hn::Load(d, ej + (odd * kWidth + v) * lanes);
        HWY_UNROLL(8) for (int r = 0; r < kRows<kWidth>; ++r) {
          const V wr = hn::Set(d, wj[odd * kRowBlock + r]);
          for (int v = 0; v < kWidth; ++v) row[r][v] = hn::MulAdd(wr, c[v], row[r][v]);
        }
        next[odd] += fetch[odd].step;
      }
      wj += 2 * kRowBlock;
      ej += 2 * kWidth * lanes;
    }
    for (int v = 0; v < kWidth; ++v) {
      if (ends_rows) {
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
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_PANEL_INL_H_
