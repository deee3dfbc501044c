// SPDX-License-Identifier: Apache-2.0
#include "kernels/reward/reward.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/reward/reward.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/contrib/math/math-inl.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void SaturatingReward(int n_rows, int n_features, const double* HWY_RESTRICT a,
                      const double* HWY_RESTRICT b, double width,
                      const double* HWY_RESTRICT features, double* HWY_RESTRICT rewards) {
  const hn::ScalableTag<double> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto factor = hn::Set(d, -0.5 / (width * width));
  for (int lane = 0; lane < kTileLanes; lane += lanes) {
    auto distance = hn::Zero(d);
    for (int r = 0; r < n_rows; ++r) {
      auto y = hn::Set(d, -b[r]);
      for (int f = 0; f < n_features; ++f) {
        const auto x = hn::Load(d, features + f * kTileLanes + lane);
        y = hn::MulAdd(hn::Set(d, a[r * n_features + f]), x, y);
      }
      distance = hn::MulAdd(y, y, distance);
    }
    hn::Store(hn::Exp(d, hn::Mul(factor, distance)), d, rewards + lane);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(SaturatingReward);

void SaturatingRewardTile(int n_rows, int n_features, const double* a, const double* b,
                          double width, const double* features, double* rewards) {
  HWY_DYNAMIC_DISPATCH(SaturatingReward)(n_rows, n_features, a, b, width, features, rewards);
}

}  // namespace downpour
#endif  // HWY_ONCE
