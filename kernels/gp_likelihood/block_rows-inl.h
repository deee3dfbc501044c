// SPDX-License-Identifier: Apache-2.0

// Tiles of a triangular factorisation in registers, in Highway's current target.
#if defined(DOWNPOUR_BLOCK_ROWS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_BLOCK_ROWS_INL_H_
#undef DOWNPOUR_BLOCK_ROWS_INL_H_
#else
#define DOWNPOUR_BLOCK_ROWS_INL_H_
#endif

#include <cmath>
#include <cstddef>

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using VectorTag = hn::ScalableTag<double>;
using Vector = hn::Vec<VectorTag>;
// A block has as many rows as a vector has lanes, and as many columns, which lie one after the
// other. A block row is a row of blocks.
constexpr int kBlock = static_cast<int>(hn::MaxLanes(VectorTag()));
constexpr std::size_t kBlockSize = kBlock * kBlock;
// Blocks of a tile, one below the other: their columns fill the registers with accumulators.
constexpr int kTileBlocks = 3;
template <int kRows>
using Tile = Vector[kRows][kBlock];

HWY_INLINE void LoadBlock(const double* HWY_RESTRICT from, Vector (&block)[kBlock]) {
  for (int c = 0; c < kBlock; ++c) block[c] = hn::Load(VectorTag(), from + c * kBlock);
}

template <int kRows>
HWY_INLINE void StoreTile(const Tile<kRows>& tile, double* HWY_RESTRICT to, std::size_t pitch) {
  for (int r = 0; r < kRows; ++r) {
    for (int c = 0; c < kBlock; ++c)
      hn::Store(tile[r][c], VectorTag(), to + r * pitch + c * kBlock);
  }
}

// Subtracts A B^T from the tile's first kUsed blocks; A has kUsed block rows, `pitch` apart, B one.
template <int kUsed, int kRows>
HWY_INLINE void SubtractProduct(const double* HWY_RESTRICT a, std::size_t pitch,
                                const double* HWY_RESTRICT b, int n_blocks, Tile<kRows>& tile) {
  const VectorTag d;
  for (const double* const end = b + n_blocks * kBlockSize; b != end; a += kBlock, b += kBlock) {
    Vector column[kUsed];
    for (int r = 0; r < kUsed; ++r) column[r] = hn::Load(d, a + r * pitch);
    HWY_UNROLL(8) for (int c = 0; c < kBlock; ++c) {
      const Vector factor = hn::Set(d, b[c]);
      for (int r = 0; r < kUsed; ++r) tile[r][c] = hn::NegMulAdd(column[r], factor, tile[r][c]);
    }
  }
}

// The same where block row r of A begins with r blocks of zeros, which are not there to read.
template <int kRows>
HWY_INLINE void SubtractStaircase(const double* HWY_RESTRICT a, std::size_t pitch,
                                  const double* HWY_RESTRICT b, int n_blocks, Tile<kRows>& tile) {
  if constexpr (kRows > 1) SubtractProduct<1>(a, pitch, b, 1, tile);
  if constexpr (kRows > 2) SubtractProduct<2>(a + kBlockSize, pitch, b + kBlockSize, 1, tile);
  constexpr std::size_t kSteps = (kRows - 1) * kBlockSize;
  SubtractProduct<kRows>(a + kSteps, pitch, b + kSteps, n_blocks - (kRows - 1), tile);
}

// Multiplies the tile by T^-T; T is a lower-triangular block, `reciprocals` those of its diagonal.
template <int kRows>
HWY_INLINE void SolveTile(const double* HWY_RESTRICT t, const double* HWY_RESTRICT reciprocals,
                          Tile<kRows>& tile) {
  const VectorTag d;
  HWY_UNROLL(8) for (int c = 0; c < kBlock; ++c) {
    HWY_UNROLL(8) for (int m = 0; m < c; ++m) {
      const Vector factor = hn::Set(d, t[m * kBlock + c]);
      for (int r = 0; r < kRows; ++r) tile[r][c] = hn::NegMulAdd(tile[r][m], factor, tile[r][c]);
    }
    const Vector reciprocal = hn::Set(d, reciprocals[c]);
    for (int r = 0; r < kRows; ++r) tile[r][c] = hn::Mul(tile[r][c], reciprocal);
  }
}

// Cholesky factorisation of the tile's first block, and the solution for the blocks below. Writes
// the first block's factor to `t` (its upper triangle is rounding) and the reciprocals of its
// diagonal; false where a pivot is not positive.
template <int kRows>
HWY_INLINE bool FactoriseTile(double* t, double* HWY_RESTRICT reciprocals, Tile<kRows>& tile) {
  const VectorTag d;
  for (int c = 0; c < kBlock; ++c) {
    hn::Store(tile[0][c], d, t + c * kBlock);
    const double pivot = t[c * kBlock + c];
    if (!(pivot > 0)) return false;
    reciprocals[c] = 1 / std::sqrt(pivot);
    const Vector reciprocal = hn::Set(d, reciprocals[c]);
    for (int r = 0; r < kRows; ++r) tile[r][c] = hn::Mul(tile[r][c], reciprocal);
    hn::Store(tile[0][c], d, t + c * kBlock);
    for (int m = c + 1; m < kBlock; ++m) {
      const Vector factor = hn::Set(d, t[c * kBlock + m]);
      for (int r = 0; r < kRows; ++r) tile[r][m] = hn::NegMulAdd(tile[r][c], factor, tile[r][m]);
    }
  }
  return true;
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_BLOCK_ROWS_INL_H_
