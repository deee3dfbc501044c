// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_likelihood/gp_likelihood.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/gp_likelihood/gp_likelihood.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/gp_likelihood/factor-inl.h"
#include "kernels/gp_query/exp2_negative-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Noise-free K, the lower blocks; rows beyond n are zero.
void Covariance(const Problem& p, const Workspace& w) {
  const VectorTag d;
  for (int i = 0; i < w.n_blocks; ++i) {
    const double* const rows = p.scaled + i * kBlock;
    const auto real_row =
        hn::FirstN(d, static_cast<std::size_t>(std::min(kBlock, p.n - i * kBlock)));
    const Vector signal_variance = hn::IfThenElseZero(real_row, hn::Set(d, p.signal_variance));
    for (int j = 0; j <= i; ++j) {
      const double* const columns = p.scaled + j * kBlock;
      Vector s[kBlock];
      for (Vector& sum : s) sum = hn::Zero(d);
      for (int k = 0; k < p.dim; ++k) {
        const std::size_t row = static_cast<std::size_t>(k) * p.ld;
        const Vector x = hn::LoadU(d, rows + row);
        HWY_UNROLL(8) for (int c = 0; c < kBlock; ++c) {
          const Vector delta = hn::Sub(x, hn::Set(d, columns[row + c]));
          s[c] = hn::MulAdd(delta, delta, s[c]);
        }
      }
      const Vector log2_e = hn::Set(d, 0.5 * std::numbers::log2e);
      for (Vector& sum : s) sum = hn::Mul(sum, log2_e);
      Exp2Negative(d, s);
      double* const k = w.K(i, j);
      for (int c = 0; c < kBlock; ++c) hn::Store(hn::Mul(signal_variance, s[c]), d, k + c * kBlock);
    }
  }
}

// Adds to the gradient what the tile of kRows blocks from block row i on, block column j, has in
//   dL/dlog p = 1/2 tr((alpha alpha^T - K^-1) dK/dlog p).
template <int kRows>
HWY_NOINLINE void AddGradient(const Problem& p, const Workspace& w, int i, int j,
                              double* gradient) {
  const VectorTag d;
  Tile<kRows> tile;
  for (int r = 0; r < kRows; ++r) {
    const Vector alpha = hn::Load(d, w.alpha + (i + r) * kBlock);
    for (int c = 0; c < kBlock; ++c) {
      tile[r][c] = hn::Mul(alpha, hn::Set(d, w.alpha[j * kBlock + c]));
    }
  }
  SubtractStaircase<kRows>(w.U(i, i), w.pitch, w.U(j, i), w.n_blocks - i, tile);
  if (i == j) {
    HWY_ALIGN double diagonal[kBlockSize];
    for (int c = 0; c < kBlock; ++c) hn::Store(tile[0][c], d, diagonal + c * kBlock);
    for (int c = 0; c < std::min(kBlock, p.n - i * kBlock); ++c) {
      gradient[p.dim + 1] += p.noise_variance * diagonal[c * kBlock + c];
    }
  }
  Vector total = hn::Zero(d);
  for (int r = 0; r < kRows; ++r) {
    // Both triangles of a block on the diagonal are here, one of each pair elsewhere.
    const Vector share = hn::Set(d, i + r == j ? 0.5 : 1.0);
    for (int c = 0; c < kBlock; ++c) {
      const Vector k = hn::Mul(share, hn::Load(d, w.K(i + r, j) + c * kBlock));
      tile[r][c] = hn::Mul(tile[r][c], k);
      total = hn::Add(total, tile[r][c]);
    }
  }
  gradient[p.dim] += 2 * hn::GetLane(hn::SumOfLanes(d, total));
  for (int k = 0; k < p.dim; ++k) {
    const double* const x = p.scaled + static_cast<std::size_t>(k) * p.ld;
    Vector sums[kRows];
    for (int r = 0; r < kRows; ++r) {
      sums[r] = hn::Zero(d);
      const Vector row = hn::LoadU(d, x + (i + r) * kBlock);
      for (int c = 0; c < kBlock; ++c) {
        const Vector delta = hn::Sub(row, hn::Set(d, x[j * kBlock + c]));
        sums[r] = hn::MulAdd(hn::Mul(tile[r][c], delta), delta, sums[r]);
      }
    }
    for (int r = 1; r < kRows; ++r) sums[0] = hn::Add(sums[0], sums[r]);
    gradient[k] += hn::GetLane(hn::SumOfLanes(d, sums[0]));
  }
}

double Likelihood(int n, int dim, const double* scaled, int ld, const double* targets,
                  double signal_variance, double noise_variance, double* scratch,
                  double* gradient) {
  const Problem p{n, dim, scaled, ld, targets, signal_variance, noise_variance};
  const Workspace w(p.n, scratch);
  Covariance(p, w);
  if (!Factorise(p, w)) return std::numeric_limits<double>::quiet_NaN();
  double quadratic = 0, log_determinant = 0;  // y^T K^-1 y, -1/2 log |K|
  const double* const z = w.L(w.n_blocks, 0);
  for (int i = 0; i < p.n; ++i) {
    quadratic += z[i * kBlock] * z[i * kBlock];
    log_determinant += std::log(w.reciprocals[i]);
  }
  const double value =
      log_determinant - 0.5 * quadratic - 0.5 * p.n * std::log(2 * std::numbers::pi);
  if (gradient == nullptr) return value;
  Invert(w);
  SolveAlpha(w);
  std::fill_n(gradient, p.dim + 2, 0.0);
  ForEachTile(w.n_blocks, [&](auto rows, int first) {
    constexpr int kRows = rows;
    for (int j = 0; j <= first; ++j) AddGradient<kRows>(p, w, first, j, gradient);
    if constexpr (kRows > 1) AddGradient<kRows - 1>(p, w, first + 1, first + 1, gradient);
    if constexpr (kRows > 2) AddGradient<kRows - 2>(p, w, first + 2, first + 2, gradient);
  });
  return value;
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Likelihood);

// For blocks of 8, the largest: smaller ones need no more.
std::size_t GpLikelihoodScratch(int n) {
  const std::size_t blocks = (static_cast<std::size_t>(n) + 7) / 8;
  return 64 * ((blocks + 1) * (blocks + 1) + blocks * (blocks + 1) / 2) + 16 * blocks;
}

double GpLikelihood(int n, int dim, const double* scaled, int ld, const double* targets,
                    double signal_variance, double noise_variance, double* scratch,
                    double* gradient) {
  return HWY_DYNAMIC_DISPATCH(Likelihood)(n, dim, scaled, ld, targets, signal_variance,
                                          noise_variance, scratch, gradient);
}

}  // namespace downpour
#endif  // HWY_ONCE
