// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_query/gp_query.h"

#include <cmath>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/gp_query/gp_query.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/contrib/math/math-inl.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;

constexpr int kVectors =
    3;  // vectors a group of lanes: with kRows accumulators each, all registers
constexpr int kRows = HWY_MAX_BYTES >= 64 ? 8 : 4;
static_assert(GpFactor::kRowBlock % kRows == 0);
static_assert(kTileLanes % (kVectors * (HWY_MAX_BYTES / sizeof(double))) == 0);

// e_i for every point and the mean, for the group of lanes that starts at `x`.
HWY_INLINE void CovarianceAndMean(const GpFactor& f, const double* HWY_RESTRICT x,
                                  double* HWY_RESTRICT e, double* HWY_RESTRICT mean) {
  const D d;
  const size_t lanes = hn::Lanes(d);
  // Highway's Exp turns NaN into 0: 0 x starts the sums, so that a lane that is not finite stays
  // so.
  V m0 = hn::Zero(d), m1 = m0, m2 = m0;
  for (int k = 0; k < f.dim; ++k) {
    const double* HWY_RESTRICT q = x + k * kTileLanes;
    m0 = hn::MulAdd(hn::Zero(d), hn::Load(d, q), m0);
    m1 = hn::MulAdd(hn::Zero(d), hn::Load(d, q + lanes), m1);
    m2 = hn::MulAdd(hn::Zero(d), hn::Load(d, q + 2 * lanes), m2);
  }
  const double* HWY_RESTRICT input = f.inputs.data();
  for (int i = 0; i < f.n_padded; ++i, input += f.dim, e += kTileLanes) {
    V s0 = hn::Zero(d), s1 = s0, s2 = s0;
    for (int k = 0; k < f.dim; ++k) {
      const V c = hn::Set(d, input[k]);
      const double* HWY_RESTRICT q = x + k * kTileLanes;
      const V t0 = hn::Sub(hn::Load(d, q), c);
      const V t1 = hn::Sub(hn::Load(d, q + lanes), c);
      const V t2 = hn::Sub(hn::Load(d, q + 2 * lanes), c);
      s0 = hn::MulAdd(t0, t0, s0);
      s1 = hn::MulAdd(t1, t1, s1);
      s2 = hn::MulAdd(t2, t2, s2);
    }
    const V e0 = hn::Exp(d, hn::Neg(s0));
    const V e1 = hn::Exp(d, hn::Neg(s1));
    const V e2 = hn::Exp(d, hn::Neg(s2));
    hn::Store(e0, d, e);
    hn::Store(e1, d, e + lanes);
    hn::Store(e2, d, e + 2 * lanes);
    const V w = hn::Set(d, f.weights[i]);
    m0 = hn::MulAdd(w, e0, m0);
    m1 = hn::MulAdd(w, e1, m1);
    m2 = hn::MulAdd(w, e2, m2);
  }
  hn::Store(m0, d, mean);
  hn::Store(m1, d, mean + lanes);
  hn::Store(m2, d, mean + 2 * lanes);
}

// signal_variance - |W e|^2 for a group of lanes: kRows rows of W e at a time live in registers and
// are squared there, so that W e is never stored. A mean that is not finite spoils the variance.
HWY_INLINE void Variance(const GpFactor& f, const double* HWY_RESTRICT e,
                         const double* HWY_RESTRICT mean, double* HWY_RESTRICT variance) {
  const D d;
  const size_t lanes = hn::Lanes(d);
  const auto zero_or_nan = [&](V m) { return hn::Sub(m, m); };
  V n0 = zero_or_nan(hn::Load(d, mean));
  V n1 = zero_or_nan(hn::Load(d, mean + lanes));
  V n2 = zero_or_nan(hn::Load(d, mean + 2 * lanes));
  const double* HWY_RESTRICT block = f.triangle.data();
  for (int columns = GpFactor::kRowBlock; columns <= f.n_padded; columns += GpFactor::kRowBlock) {
    for (int half = 0; half < GpFactor::kRowBlock; half += kRows) {
      V acc0[kRows], acc1[kRows], acc2[kRows];
      for (int r = 0; r < kRows; ++r) acc0[r] = acc1[r] = acc2[r] = hn::Zero(d);
      const double* HWY_RESTRICT w = block + half;
      const double* HWY_RESTRICT column = e;
      for (int j = 0; j < columns; ++j, w += GpFactor::kRowBlock, column += kTileLanes) {
        const V e0 = hn::Load(d, column);
        const V e1 = hn::Load(d, column + lanes);
        const V e2 = hn::Load(d, column + 2 * lanes);
        HWY_UNROLL(8) for (int r = 0; r < kRows; ++r) {
          const V wr = hn::Set(d, w[r]);
          acc0[r] = hn::MulAdd(wr, e0, acc0[r]);
          acc1[r] = hn::MulAdd(wr, e1, acc1[r]);
          acc2[r] = hn::MulAdd(wr, e2, acc2[r]);
        }
      }
      for (int r = 0; r < kRows; ++r) {
        n0 = hn::MulAdd(acc0[r], acc0[r], n0);
        n1 = hn::MulAdd(acc1[r], acc1[r], n1);
        n2 = hn::MulAdd(acc2[r], acc2[r], n2);
      }
    }
    block += GpFactor::kRowBlock * columns;
  }
  const V signal = hn::Set(d, f.signal_variance);
  // The operands' order lets a NaN through: Max(NaN, 0) would hide a lane that is not finite.
  const auto clamp = [&](V norm) {
    const V v = hn::Sub(signal, norm);
    return hn::IfThenElse(hn::Lt(v, hn::Zero(d)), hn::Zero(d), v);
  };
  hn::Store(clamp(n0), d, variance);
  hn::Store(clamp(n1), d, variance + lanes);
  hn::Store(clamp(n2), d, variance + 2 * lanes);
}

void QueryTile(const GpFactor& f, const double* x, double* scratch, double* mean,
               double* variance) {
  const D d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  double* HWY_RESTRICT scaled = scratch;
  double* HWY_RESTRICT e = scratch + f.dim * kTileLanes;
  for (int k = 0; k < f.dim; ++k) {
    const V s = hn::Set(d, f.scale[k]);
    for (int lane = 0; lane < kTileLanes; lane += lanes) {
      const int at = k * kTileLanes + lane;
      hn::Store(hn::Mul(s, hn::Load(d, x + at)), d, scaled + at);
    }
  }
  for (int lane = 0; lane < kTileLanes; lane += kVectors * lanes) {
    CovarianceAndMean(f, scaled + lane, e + lane, mean + lane);
    if (variance != nullptr) Variance(f, e + lane, mean + lane, variance + lane);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(QueryTile);

GpFactor PackGpFactor(int n, int dim, const double* inputs, const double* lengthscales,
                      double signal_std, double noise_std, const double* weights,
                      const double* inverse_factor) {
  constexpr int kBlock = GpFactor::kRowBlock;
  GpFactor f;
  f.n = n;
  f.dim = dim;
  f.n_padded = (n + kBlock - 1) / kBlock * kBlock;
  f.signal_variance = signal_std * signal_std;
  f.noise_variance = noise_std * noise_std;
  f.scale.resize(dim);
  for (int k = 0; k < dim; ++k) f.scale[k] = std::sqrt(0.5) / lengthscales[k];
  f.inputs.assign(static_cast<std::size_t>(f.n_padded) * dim, 0.0);
  f.weights.assign(f.n_padded, 0.0);
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < dim; ++k) f.inputs[i * dim + k] = f.scale[k] * inputs[i * dim + k];
    f.weights[i] = f.signal_variance * weights[i];
  }
  const std::size_t blocks = f.n_padded / kBlock;
  f.triangle.reserve(kBlock * kBlock * blocks * (blocks + 1) / 2);
  for (int first = 0; first < f.n_padded; first += kBlock) {
    for (int j = 0; j < first + kBlock; ++j) {
      for (int i = first; i < first + kBlock; ++i) {
        const bool inside = i < n && j <= i;
        f.triangle.push_back(
            inside ? f.signal_variance * inverse_factor[static_cast<std::size_t>(j) * n + i] : 0.0);
      }
    }
  }
  return f;
}

std::size_t GpQueryScratchSize(const GpFactor& factor) {
  return static_cast<std::size_t>(factor.dim + factor.n_padded) * kTileLanes;
}

void GpQueryTile(const GpFactor& factor, const double* x, double* scratch, double* mean,
                 double* variance) {
  HWY_DYNAMIC_DISPATCH(QueryTile)(factor, x, scratch, mean, variance);
}

}  // namespace downpour
#endif  // HWY_ONCE
