// SPDX-License-Identifier: Apache-2.0
#include "kernels/transition/transition.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/transition/transition.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void Transition(const double* HWY_RESTRICT mean, const double* HWY_RESTRICT variance,
                double noise_variance, const double* HWY_RESTRICT z, double clamp, double limit,
                double* HWY_RESTRICT state, double* HWY_RESTRICT alive) {
  const hn::ScalableTag<double> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int lane = 0; lane < kTileLanes; lane += lanes) {
    auto next = hn::Add(hn::Load(d, state + lane), hn::Load(d, mean + lane));
    if (variance != nullptr) {
      auto sample = hn::Load(d, z + lane);
      if (clamp > 0) sample = hn::Clamp(sample, hn::Set(d, -clamp), hn::Set(d, clamp));
      const auto total = hn::Add(hn::Load(d, variance + lane), hn::Set(d, noise_variance));
      next = hn::MulAdd(hn::Sqrt(total), sample, next);
    }
    // False for NaN too.
    const auto inside = hn::Le(hn::Abs(next), hn::Set(d, limit));
    hn::Store(hn::IfThenElseZero(inside, next), d, state + lane);
    hn::Store(hn::IfThenElseZero(inside, hn::Load(d, alive + lane)), d, alive + lane);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Transition);

void TransitionTile(const double* mean, const double* variance, double noise_variance,
                    const double* z, double clamp, double limit, double* state, double* alive) {
  HWY_DYNAMIC_DISPATCH(Transition)(mean, variance, noise_variance, z, clamp, limit, state, alive);
}

}  // namespace downpour
#endif  // HWY_ONCE
