// SPDX-License-Identifier: Apache-2.0
#include "kernels/mlp/mlp.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/mlp/mlp.cc"
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

// Highway's Tanh rounds to at most 1 + 4 ulp: clip, so that actions keep their limits.
HWY_INLINE V BoundedTanh(V x) {
  const D d;
  const V one = hn::Set(d, 1.0);
  return hn::Max(hn::Min(hn::Tanh(d, x), one), hn::Neg(one));
}

void Mlp(const MlpShape& shape, const double* HWY_RESTRICT parameters,
         const double* HWY_RESTRICT input_scale, const double* HWY_RESTRICT limits,
         const double* HWY_RESTRICT inputs, double* HWY_RESTRICT outputs) {
  const D d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const double* HWY_RESTRICT b0 = parameters + shape.n_hidden * shape.n_inputs * kTileLanes;
  const double* HWY_RESTRICT w1 = b0 + shape.n_hidden * kTileLanes;
  const double* HWY_RESTRICT b1 = w1 + shape.n_outputs * shape.n_hidden * kTileLanes;
  for (int lane = 0; lane < kTileLanes; lane += lanes) {
    // The outputs are the accumulators of the second layer, so that no hidden layer is stored.
    for (int o = 0; o < shape.n_outputs; ++o) {
      hn::Store(hn::Load(d, b1 + o * kTileLanes + lane), d, outputs + o * kTileLanes + lane);
    }
    const double* HWY_RESTRICT w0 = parameters + lane;
    for (int h = 0; h < shape.n_hidden; ++h) {
      V sum = hn::Load(d, b0 + h * kTileLanes + lane);
      for (int i = 0; i < shape.n_inputs; ++i, w0 += kTileLanes) {
        const V x =
            hn::Mul(hn::Set(d, input_scale[i]), hn::Load(d, inputs + i * kTileLanes + lane));
        sum = hn::MulAdd(hn::Load(d, w0), x, sum);
      }
      const V y = BoundedTanh(sum);
      for (int o = 0; o < shape.n_outputs; ++o) {
        double* HWY_RESTRICT out = outputs + o * kTileLanes + lane;
        const V w = hn::Load(d, w1 + (o * shape.n_hidden + h) * kTileLanes + lane);
        hn::Store(hn::MulAdd(w, y, hn::Load(d, out)), d, out);
      }
    }
    for (int o = 0; o < shape.n_outputs; ++o) {
      double* HWY_RESTRICT out = outputs + o * kTileLanes + lane;
      hn::Store(hn::Mul(hn::Set(d, limits[o]), BoundedTanh(hn::Load(d, out))), d, out);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Mlp);

void MlpTile(const MlpShape& shape, const double* parameters, const double* input_scale,
             const double* limits, const double* inputs, double* outputs) {
  HWY_DYNAMIC_DISPATCH(Mlp)(shape, parameters, input_scale, limits, inputs, outputs);
}

}  // namespace downpour
#endif  // HWY_ONCE
