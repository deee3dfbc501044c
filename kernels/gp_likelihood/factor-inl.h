// SPDX-License-Identifier: Apache-2.0

// Cholesky factor of K and its inverse, block row by block row, in Highway's current target.
#if defined(DOWNPOUR_FACTOR_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DOWNPOUR_FACTOR_INL_H_
#undef DOWNPOUR_FACTOR_INL_H_
#else
#define DOWNPOUR_FACTOR_INL_H_
#endif

#include <algorithm>
#include <cstddef>
#include <type_traits>

#include "hwy/highway.h"
#include "kernels/gp_likelihood/block_rows-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

struct Problem {
  int n, dim;
  const double* scaled;
  int ld;
  const double* targets;
  double signal_variance, noise_variance;
};

// Cholesky factorisation of K with y^T and I as further rows below:
//   [ K ; y^T ; I ] L^-T = [ L ; z^T ; U ],  z = L^-1 y,  U = L^-T,
// so that alpha = U z and K^-1 = U U^T: three times the same product of block rows, each tile read
// and written once. Rows beyond n are those of the identity.
struct Workspace {
  int n_blocks;
  std::size_t pitch;    // of the factor's block rows
  double* factor;       // n_blocks + 1 block rows, the last z^T
  double* covariance;   // noise-free K: block row i has i + 1 blocks
  double* reciprocals;  // of L's diagonal
  double* alpha;

  Workspace(int n, double* scratch) : n_blocks((n + kBlock - 1) / kBlock) {
    const std::size_t blocks = n_blocks;
    pitch = (blocks + 1) * kBlockSize;
    factor = scratch;
    covariance = factor + (blocks + 1) * pitch;
    reciprocals = covariance + blocks * (blocks + 1) / 2 * kBlockSize;
    alpha = reciprocals + blocks * kBlock;
  }
  // Block (i, k) of L, k <= i, and z^T for i = n_blocks.
  double* L(int i, int k) const { return factor + i * pitch + k * kBlockSize; }
  // Block (i, k) of U, k >= i.
  double* U(int i, int k) const { return factor + i * pitch + (k + 1) * kBlockSize; }
  double* K(int i, int k) const {
    return covariance + (static_cast<std::size_t>(i) * (i + 1) / 2 + k) * kBlockSize;
  }
};

// Calls body(std::integral_constant<int, rows>(), first) for the tiles that the block rows are cut
// into; block rows of one, which load more than they compute, are avoided.
template <class Body>
HWY_INLINE void ForEachTile(int n_blocks, const Body& body) {
  int first = 0;
  for (; n_blocks - first == 3 || n_blocks - first > 4; first += 3) {
    body(std::integral_constant<int, 3>(), first);
  }
  for (; n_blocks - first >= 2; first += 2) body(std::integral_constant<int, 2>(), first);
  if (n_blocks - first == 1) body(std::integral_constant<int, 1>(), first);
}

// L's tile of kRows blocks from block row i on, block column j < i; `start` holds the matrix.
template <int kRows>
HWY_NOINLINE void SolveRows(const Workspace& w, int i, int j,
                            const double* const (&start)[kTileBlocks]) {
  Tile<kRows> tile;
  for (int r = 0; r < kRows; ++r) LoadBlock(start[r], tile[r]);
  SubtractProduct<kRows>(w.L(i, 0), w.pitch, w.L(j, 0), j, tile);
  SolveTile<kRows>(w.L(j, j), w.reciprocals + j * kBlock, tile);
  StoreTile<kRows>(tile, w.L(i, j), w.pitch);
}

// The same for block column i; false where there is no factor.
template <int kRows>
HWY_NOINLINE bool FactoriseRows(const Problem& p, const Workspace& w, int i) {
  Tile<kRows> tile;
  double* const l = w.L(i, i);
  std::copy_n(w.K(i, i), kBlockSize, l);
  for (int c = 0; c < kBlock; ++c) {
    l[c * kBlock + c] += i * kBlock + c < p.n ? p.noise_variance : 1.0;
  }
  for (int r = 0; r < kRows; ++r) LoadBlock(r == 0 ? l : w.K(i + r, i), tile[r]);
  SubtractProduct<kRows>(l - i * kBlockSize, w.pitch, l - i * kBlockSize, i, tile);
  if (!FactoriseTile<kRows>(l, w.reciprocals + i * kBlock, tile)) return false;
  StoreTile<kRows>(tile, l, w.pitch);
  return true;
}

// L and z; false where there is no factor.
inline bool Factorise(const Problem& p, const Workspace& w) {
  bool positive = true;
  ForEachTile(w.n_blocks, [&](auto rows, int first) {
    constexpr int kRows = rows;
    for (int j = 0; j < first && positive; ++j) {
      const double* start[kTileBlocks] = {w.K(first, j)};
      for (int r = 1; r < kRows; ++r) start[r] = w.K(first + r, j);
      SolveRows<kRows>(w, first, j, start);
    }
    positive = positive && FactoriseRows<kRows>(p, w, first);
    if constexpr (kRows > 1) positive = positive && FactoriseRows<kRows - 1>(p, w, first + 1);
    if constexpr (kRows > 2) positive = positive && FactoriseRows<kRows - 2>(p, w, first + 2);
  });
  if (!positive) return false;
  double* const z = w.L(w.n_blocks, 0);
  std::fill_n(z, w.n_blocks * kBlockSize, 0.0);
  for (int i = 0; i < p.n; ++i) z[i * kBlock] = p.targets[i];
  for (int j = 0; j < w.n_blocks; ++j) {
    SolveRows<1>(w, w.n_blocks, j, {w.L(w.n_blocks, j)});
  }
  return true;
}

// U's tile of kRows blocks from block row i on, block column j >= i + kRows - 1.
template <int kRows>
HWY_NOINLINE void InvertRows(const Workspace& w, int i, int j) {
  const VectorTag d;
  Tile<kRows> tile;
  for (int r = 0; r < kRows; ++r) {
    for (int c = 0; c < kBlock; ++c) {
      const auto one = hn::Eq(hn::Iota(d, 0), hn::Set(d, i + r == j ? c : -1.0));
      tile[r][c] = hn::IfThenElseZero(one, hn::Set(d, 1.0));
    }
  }
  SubtractStaircase<kRows>(w.U(i, i), w.pitch, w.L(j, i), j - i, tile);
  SolveTile<kRows>(w.L(j, j), w.reciprocals + j * kBlock, tile);
  StoreTile<kRows>(tile, w.U(i, j), w.pitch);
}

inline void Invert(const Workspace& w) {
  ForEachTile(w.n_blocks, [&](auto rows, int first) {
    constexpr int kRows = rows;
    if constexpr (kRows > 1) InvertRows<1>(w, first, first);
    if constexpr (kRows > 2) InvertRows<2>(w, first, first + 1);
    for (int j = first + kRows - 1; j < w.n_blocks; ++j) InvertRows<kRows>(w, first, j);
  });
}

// alpha = U z.
inline void SolveAlpha(const Workspace& w) {
  const VectorTag d;
  for (int i = 0; i < w.n_blocks; ++i) {
    Vector sums[kBlock];
    for (Vector& sum : sums) sum = hn::Zero(d);
    for (int k = i; k < w.n_blocks; ++k) {
      const double* const u = w.U(i, k);
      const double* const z = w.L(w.n_blocks, k);
      for (int c = 0; c < kBlock; ++c) {
        sums[c] = hn::MulAdd(hn::Load(d, u + c * kBlock), hn::Set(d, z[c * kBlock]), sums[c]);
      }
    }
    for (int c = 1; c < kBlock; ++c) sums[0] = hn::Add(sums[0], sums[c]);
    hn::Store(sums[0], d, w.alpha + i * kBlock);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#endif  // DOWNPOUR_FACTOR_INL_H_
