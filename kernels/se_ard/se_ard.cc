// SPDX-License-Identifier: Apache-2.0
#include "kernels/se_ard/se_ard.h"

#include <cstddef>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/se_ard/se_ard.cc"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// After highway.h: a header that each target includes anew.
#include "hwy/contrib/math/math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// k[i] for the Lanes(d) rows from `row` on, against point `column`. Every lane is computed alike,
// so that an entry's bits do not depend on where in a vector it falls.
template <class D>
HWY_INLINE void CovarianceRows(D d, int dim, const double* scaled, std::size_t ld, int row,
                               int column, double signal_variance, double* k) {
  auto distance = hn::Zero(d);
  for (int i = 0; i < dim; ++i) {
    const double* x = scaled + i * ld;
    const auto delta = hn::Sub(hn::LoadU(d, x + row), hn::Set(d, x[column]));
    distance = hn::MulAdd(delta, delta, distance);
  }
  const auto exponential = hn::Exp(d, hn::Mul(hn::Set(d, -0.5), distance));
  hn::StoreU(hn::Mul(hn::Set(d, signal_variance), exponential), d, k + row);
}

void CovarianceLower(int n, int dim, const double* scaled, int ld, double signal_variance,
                     double* k, int ldk) {
  const hn::ScalableTag<double> d;
  const hn::CappedTag<double, 1> single;
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int j = 0; j < n; ++j) {
    double* column = k + static_cast<std::size_t>(j) * ldk;
    int i = j;
    for (; i + lanes <= n; i += lanes) {
      CovarianceRows(d, dim, scaled, ld, i, j, signal_variance, column);
    }
    if (i == n) continue;
    if (n - j >= lanes) {  // the last rows once more, as one whole vector
      CovarianceRows(d, dim, scaled, ld, n - lanes, j, signal_variance, column);
      continue;
    }
    for (; i < n; ++i) CovarianceRows(single, dim, scaled, ld, i, j, signal_variance, column);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(CovarianceLower);

void SeArdCovarianceLower(int n, int dim, const double* scaled, int ld, double signal_variance,
                          double* k, int ldk) {
  HWY_DYNAMIC_DISPATCH(CovarianceLower)(n, dim, scaled, ld, signal_variance, k, ldk);
}

}  // namespace downpour
#endif
