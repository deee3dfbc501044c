// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_query/covariance_passes.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/gp_query/covariance_passes.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/gp_query/covariances-inl.h"
#include "kernels/gp_query/group-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// A full tile is groups of three vectors on every target.
template <CovariancePass kLast, typename T>
void Passes(const GpFactorT<T>& f, const double* HWY_RESTRICT x, T* HWY_RESTRICT scratch) {
  constexpr int kWidth = 3;
  const int lanes = kWidth * static_cast<int>(hn::Lanes(hn::ScalableTag<T>()));
  const hn::ScalableTag<double> d;
  for (int first = 0; first < kTileLanes; first += lanes) {
    const Group<T> group(f, lanes, scratch + Group<T>::Rows(f) * first);
    ScaleQueries(d, f, x + first, lanes, group.queries);
    CovariancesAndMean<kWidth, kLast>(f, group.queries, group.e, group.mean);
  }
}

template <typename T>
void PassesUpTo(const GpFactorT<T>& f, CovariancePass last, const double* x, void* scratch) {
  T* const typed = static_cast<T*>(scratch);
  switch (last) {
    case CovariancePass::kDistances:
      return Passes<CovariancePass::kDistances>(f, x, typed);
    case CovariancePass::kExponentials:
      return Passes<CovariancePass::kExponentials>(f, x, typed);
    default:
      return Passes<CovariancePass::kDeflation>(f, x, typed);
  }
}

void PassesDouble(const GpFactor& f, CovariancePass last, const double* x, void* scratch) {
  PassesUpTo(f, last, x, scratch);
}
void PassesFloat(const GpFactor32& f, CovariancePass last, const double* x, void* scratch) {
  PassesUpTo(f, last, x, scratch);
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(PassesDouble);
HWY_EXPORT(PassesFloat);

void CovariancePasses(const GpFactor& factor, CovariancePass last, const double* x, void* scratch) {
  HWY_DYNAMIC_DISPATCH(PassesDouble)(factor, last, x, scratch);
}
void CovariancePasses(const GpFactor32& factor, CovariancePass last, const double* x,
                      void* scratch) {
  HWY_DYNAMIC_DISPATCH(PassesFloat)(factor, last, x, scratch);
}

}  // namespace downpour
#endif  // HWY_ONCE
