// SPDX-License-Identifier: Apache-2.0
#include "kernels/linear_policy/linear_policy.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/linear_policy/linear_policy.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/squash/squash-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void LinearPolicy(const LinearPolicyShape& shape, int n_lanes,
                  const double* HWY_RESTRICT parameters, const double* HWY_RESTRICT input_scale,
                  const double* HWY_RESTRICT limits, const double* HWY_RESTRICT inputs,
                  double* HWY_RESTRICT outputs) {
  const hn::ScalableTag<double> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const double* HWY_RESTRICT b = parameters + shape.n_outputs * shape.n_inputs * kTileLanes;
  for (int lane = 0; lane < n_lanes; lane += lanes) {
    const double* HWY_RESTRICT w = parameters + lane;
    for (int o = 0; o < shape.n_outputs; ++o) {
      auto sum = hn::Load(d, b + o * kTileLanes + lane);
      for (int i = 0; i < shape.n_inputs; ++i, w += kTileLanes) {
        const auto x =
            hn::Mul(hn::Set(d, input_scale[i]), hn::Load(d, inputs + i * kTileLanes + lane));
        sum = hn::MulAdd(hn::Load(d, w), x, sum);
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

HWY_EXPORT(LinearPolicy);

void LinearPolicyTile(const LinearPolicyShape& shape, int n_lanes, const double* parameters,
                      const double* input_scale, const double* limits, const double* inputs,
                      double* outputs) {
  HWY_DYNAMIC_DISPATCH(LinearPolicy)
  (shape, n_lanes, parameters, input_scale, limits, inputs, outputs);
}

}  // namespace downpour
#endif  // HWY_ONCE
