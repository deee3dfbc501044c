// SPDX-License-Identifier: Apache-2.0
#include "kernels/features/features.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/features/features.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/contrib/math/math-inl.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void Features(const Feature* map, int n_features, const double* HWY_RESTRICT states,
              double* HWY_RESTRICT features) {
  const hn::ScalableTag<double> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int f = 0; f < n_features; ++f) {
    const double* HWY_RESTRICT state = states + map[f].state_index * kTileLanes;
    double* HWY_RESTRICT feature = features + f * kTileLanes;
    for (int lane = 0; lane < kTileLanes; lane += lanes) {
      auto x = hn::Load(d, state + lane);
      if (map[f].kind == FeatureKind::kCosine) x = hn::Cos(d, x);
      if (map[f].kind == FeatureKind::kSine) x = hn::Sin(d, x);
      hn::Store(x, d, feature + lane);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Features);

void FeatureTile(const Feature* map, int n_features, const double* states, double* features) {
  HWY_DYNAMIC_DISPATCH(Features)(map, n_features, states, features);
}

}  // namespace downpour
#endif  // HWY_ONCE
