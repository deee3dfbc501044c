// SPDX-License-Identifier: Apache-2.0
#include "kernels/se_product/se_product.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/se_product/se_product.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/gp_query/exp2_negative-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using VectorTag = hn::CappedTag<double, kSeProductPad>;
using Vector = hn::Vec<VectorTag>;
// Rows taken together: as many exponentials alternate, and share the loads of b.
constexpr int kRows = 4;

// N_ij of rows [i, i + kRows) and columns [0, end), into `block` (kRows x ld) if kAll, with its row
// and column sums.
template <bool kWeightMatrix, bool kAll>
HWY_INLINE void Products(const SeProduct& x, int i, int end, double* HWY_RESTRICT block,
                         double* HWY_RESTRICT rows, double* HWY_RESTRICT columns) {
  const VectorTag d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const double* const p = x.p + static_cast<std::size_t>(i) * x.dim;
  Vector sums[kRows];
  for (Vector& sum : sums) sum = hn::Zero(d);
  for (int j = 0; j < end; j += lanes) {
    const Vector v = hn::Load(d, x.v + j);
    Vector s[kRows];
    HWY_UNROLL(4) for (int r = 0; r < kRows; ++r) s[r] = hn::Add(v, hn::Set(d, x.u[i + r]));
    for (int k = 0; k < x.dim; ++k) {
      const Vector b = hn::Load(d, x.b + static_cast<std::size_t>(k) * x.ld + j);
      HWY_UNROLL(4) for (int r = 0; r < kRows; ++r) {
        s[r] = hn::MulAdd(hn::Set(d, p[r * x.dim + k]), b, s[r]);
      }
    }
    HWY_UNROLL(4) for (int r = 0; r < kRows; ++r) s[r] = hn::Max(s[r], hn::Zero(d));
    Exp2Negative(d, s);
    HWY_UNROLL(4) for (int r = 0; r < kRows; ++r) {
      Vector weight;
      if constexpr (kWeightMatrix) {
        weight = hn::Load(d, x.weights + static_cast<std::size_t>(i + r) * x.ld + j);
      } else {
        weight = hn::Mul(hn::Load(d, x.column_weights + j), hn::Set(d, x.row_weights[i + r]));
      }
      // Fused in either case, so that the bits do not depend on what the compiler sees.
      sums[r] = hn::MulAdd(s[r], weight, sums[r]);
      if constexpr (kAll) {
        s[r] = hn::Mul(s[r], weight);
        hn::Store(s[r], d, block + static_cast<std::size_t>(r) * x.ld + j);
      }
    }
    if constexpr (kAll) {
      const Vector column = hn::Add(hn::Add(s[0], s[1]), hn::Add(s[2], s[3]));
      hn::Store(hn::Add(hn::Load(d, columns + j), column), d, columns + j);
    }
  }
  for (int r = 0; r < kRows; ++r) rows[i + r] = hn::GetLane(hn::SumOfLanes(d, sums[r]));
}

// moments of kRows rows and kDims dimensions: block (kRows x ld) times b^T.
template <int kDims>
HWY_INLINE void Moments(const double* HWY_RESTRICT block, const double* HWY_RESTRICT b, int ld,
                        int end, int dim, double* HWY_RESTRICT moments) {
  const VectorTag d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  Vector sums[kDims][kRows];
  for (auto& of_dim : sums) {
    for (Vector& sum : of_dim) sum = hn::Zero(d);
  }
  for (int j = 0; j < end; j += lanes) {
    Vector n[kRows];
    for (int r = 0; r < kRows; ++r)
      n[r] = hn::Load(d, block + static_cast<std::size_t>(r) * ld + j);
    for (int k = 0; k < kDims; ++k) {
      const Vector column = hn::Load(d, b + static_cast<std::size_t>(k) * ld + j);
      for (int r = 0; r < kRows; ++r) sums[k][r] = hn::MulAdd(n[r], column, sums[k][r]);
    }
  }
  for (int k = 0; k < kDims; ++k) {
    for (int r = 0; r < kRows; ++r) {
      moments[r * dim + k] = hn::GetLane(hn::SumOfLanes(d, sums[k][r]));
    }
  }
}

template <bool kWeightMatrix>
HWY_INLINE void AllRows(const SeProduct& x, double* HWY_RESTRICT block,
                        const SeProductResult& result) {
  if (result.columns != nullptr) std::fill_n(result.columns, x.ld, 0.0);
  for (int i = 0; i < x.ld; i += kRows) {
    // Up to the diagonal, in whole vectors.
    const int end = kWeightMatrix
                        ? std::min(i / kSeProductPad + 1, x.ld / kSeProductPad) * kSeProductPad
                        : x.ld;
    if (result.columns == nullptr) {
      Products<kWeightMatrix, false>(x, i, end, block, result.rows, nullptr);
      continue;
    }
    Products<kWeightMatrix, true>(x, i, end, block, result.rows, result.columns);
    double* const moments = result.moments + static_cast<std::size_t>(i) * x.dim;
    int k = 0;
    for (; k + 3 <= x.dim; k += 3) {
      Moments<3>(block, x.b + static_cast<std::size_t>(k) * x.ld, x.ld, end, x.dim, moments + k);
    }
    for (; k < x.dim; ++k) {
      Moments<1>(block, x.b + static_cast<std::size_t>(k) * x.ld, x.ld, end, x.dim, moments + k);
    }
  }
}

void Sums(const SeProduct& x, double* HWY_RESTRICT scratch, const SeProductResult& result) {
  if (x.weights != nullptr) {
    AllRows<true>(x, scratch, result);
  } else {
    AllRows<false>(x, scratch, result);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Sums);

void SeProductSums(const SeProduct& product, double* scratch, const SeProductResult& result) {
  HWY_DYNAMIC_DISPATCH(Sums)(product, scratch, result);
}

}  // namespace downpour
#endif  // HWY_ONCE
