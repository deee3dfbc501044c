// SPDX-License-Identifier: Apache-2.0
#include "kernels/movement_primitive/movement_primitive.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/movement_primitive/movement_primitive.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/squash/squash-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void MovementPrimitive(int n_weights, int n_outputs, int n_lanes,
                       const double* HWY_RESTRICT response, const double* HWY_RESTRICT parameters,
                       const double* HWY_RESTRICT limits, double* HWY_RESTRICT outputs) {
  const hn::ScalableTag<double> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int o = 0; o < n_outputs; ++o) {
    const double* HWY_RESTRICT theta = parameters + o * n_weights * kTileLanes;
    for (int lane = 0; lane < n_lanes; lane += lanes) {
      auto sum = hn::Zero(d);
      for (int i = 0; i < n_weights; ++i) {
        sum = hn::MulAdd(hn::Set(d, response[i]), hn::Load(d, theta + i * kTileLanes + lane), sum);
      }
      hn::Store(hn::Mul(hn::Set(d, limits[o]), Squash(d, sum)), d, outputs + o * kTileLanes + lane);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(MovementPrimitive);

void MovementPrimitiveTile(int n_weights, int n_outputs, int n_lanes, const double* response,
                           const double* parameters, const double* limits, double* outputs) {
  HWY_DYNAMIC_DISPATCH(MovementPrimitive)
  (n_weights, n_outputs, n_lanes, response, parameters, limits, outputs);
}

}  // namespace downpour
#endif  // HWY_ONCE
