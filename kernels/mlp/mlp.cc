// SPDX-License-Identifier: Apache-2.0
#include "kernels/mlp/mlp.h"

#include <utility>

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

// W y + b for one unit and one vector of lanes; moves w on to the next unit.
HWY_INLINE V Unit(int n_inputs, const double*& w, const double* bias, const double* y) {
  const D d;
  V sum = hn::Load(d, bias);
  for (int i = 0; i < n_inputs; ++i, w += kTileLanes) {
    sum = hn::MulAdd(hn::Load(d, w), hn::Load(d, y + i * kTileLanes), sum);
  }
  return sum;
}

// All layers for one vector of lanes: every pointer is at its first lane.
void MlpLanes(const MlpShape& shape, const double* parameters,
              const double* HWY_RESTRICT input_scale, const double* HWY_RESTRICT limits,
              const double* HWY_RESTRICT inputs, double* y, double* next, double* outputs) {
  const D d;
  for (int i = 0; i < shape.n_inputs(); ++i) {
    const V x = hn::Load(d, inputs + i * kTileLanes);
    hn::Store(hn::Mul(hn::Set(d, input_scale[i]), x), d, y + i * kTileLanes);
  }
  const int n_layers = static_cast<int>(shape.units.size()) - 1;
  for (int l = 0; l < n_layers; ++l) {
    const int n_before = shape.units[l], n_units = shape.units[l + 1];
    const double* w = parameters;
    const double* const b = w + n_before * n_units * kTileLanes;
    for (int o = 0; o < n_units; ++o) {
      const int at = o * kTileLanes;
      const V sum = Unit(n_before, w, b + at, y);
      if (l + 1 == n_layers) {
        hn::Store(hn::Mul(hn::Set(d, limits[o]), BoundedTanh(sum)), d, outputs + at);
      } else if (shape.activation == Activation::kTanh) {
        hn::Store(BoundedTanh(sum), d, next + at);
      } else {
        hn::Store(hn::Max(sum, hn::Zero(d)), d, next + at);
      }
    }
    parameters = b + n_units * kTileLanes;
    std::swap(y, next);
  }
}

void Mlp(const MlpShape& shape, int n_lanes, const double* parameters, const double* input_scale,
         const double* limits, const double* inputs, double* scratch, double* outputs) {
  const D d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  double* const second = scratch + shape.scratch_rows() / 2 * kTileLanes;
  for (int lane = 0; lane < n_lanes; lane += lanes) {
    MlpLanes(shape, parameters + lane, input_scale, limits, inputs + lane, scratch + lane,
             second + lane, outputs + lane);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Mlp);

void MlpTile(const MlpShape& shape, int n_lanes, const double* parameters,
             const double* input_scale, const double* limits, const double* inputs, double* scratch,
             double* outputs) {
  HWY_DYNAMIC_DISPATCH(Mlp)
  (shape, n_lanes, parameters, input_scale, limits, inputs, scratch, outputs);
}

}  // namespace downpour
#endif  // HWY_ONCE
