// SPDX-License-Identifier: Apache-2.0
#include "kernels/box/box.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/box/box.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;

void Map(const BoxMap& box, std::size_t n, double* values) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const double first = box.lower - box.lower_margin, last = box.upper + box.upper_margin;
  const V lower = hn::Set(d, box.lower), upper = hn::Set(d, box.upper);
  const V low_mirror = hn::Set(d, first), high_mirror = hn::Set(d, last);
  const V from = hn::Set(d, box.lower + box.lower_margin);
  const V to = hn::Set(d, box.upper - box.upper_margin);
  const V low_curve = hn::Set(d, 1 / (4 * box.lower_margin));
  const V high_curve = hn::Set(d, 1 / (4 * box.upper_margin));
  // One period has the box in its middle, so that one reflection at either mirror is enough.
  const V lowest = hn::Set(d, first - (last - first) / 2);
  const V period = hn::Set(d, 2 * (last - first));
  const V frequency = hn::Set(d, 1 / (2 * (last - first)));
  const auto image = [&](V x) {
    const V periods = hn::Floor(hn::Mul(hn::Sub(x, lowest), frequency));
    x = hn::NegMulAdd(periods, period, x);
    x = hn::IfThenElse(hn::Lt(x, low_mirror), hn::Sub(hn::Add(low_mirror, low_mirror), x), x);
    x = hn::IfThenElse(hn::Gt(x, high_mirror), hn::Sub(hn::Add(high_mirror, high_mirror), x), x);
    // What many periods away was rounded beyond a mirror must not leave the box.
    x = hn::Clamp(x, low_mirror, high_mirror);
    const V above = hn::Sub(x, low_mirror), below = hn::Sub(high_mirror, x);
    V y = hn::IfThenElse(hn::Lt(x, from), hn::MulAdd(hn::Mul(above, above), low_curve, lower), x);
    y = hn::IfThenElse(hn::Gt(x, to), hn::NegMulAdd(hn::Mul(below, below), high_curve, upper), y);
    return hn::Clamp(y, lower, upper);
  };
  std::size_t i = 0;
  for (; i + lanes <= n; i += lanes) hn::StoreU(image(hn::LoadU(d, values + i)), d, values + i);
  if (i == n) return;
  HWY_ALIGN double rest[hn::MaxLanes(D())] = {};
  std::copy(values + i, values + n, rest);
  hn::Store(image(hn::Load(d, rest)), d, rest);
  std::copy_n(rest, n - i, values + i);
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Map);

void MapToBox(const BoxMap& box, std::size_t n, double* values) {
  HWY_DYNAMIC_DISPATCH(Map)(box, n, values);
}

}  // namespace downpour
#endif  // HWY_ONCE
