// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_policy/gp_policy.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/gp_policy/gp_policy.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/contrib/math/math-inl.h"
#include "hwy/highway.h"
#include "kernels/gp_query/exp2_negative-inl.h"
#include "kernels/squash/squash-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<double, GpPolicyShape::kVectorLanes>;
using V = hn::Vec<D>;

// Vectors of lanes that GpPolicy works on at once, as one exponential waits for itself.
constexpr int kTogether = 3;

// c_f and c_f z_f of one output and one vector of lanes.
void ScalePoints(const GpPolicyShape& shape, const double* HWY_RESTRICT points,
                 const double* HWY_RESTRICT log_lengthscales, double* HWY_RESTRICT factors,
                 double* HWY_RESTRICT scaled) {
  const D d;
  const V limit = hn::Set(d, kMaxLogLengthscale);
  for (int f = 0; f < shape.n_inputs; ++f) {
    const V log_lengthscale =
        hn::Clamp(hn::Load(d, log_lengthscales + f * kTileLanes), hn::Neg(limit), limit);
    // sqrt(log2(e) / 2), so that a covariance is 2^-|difference|^2.
    const V factor = hn::Mul(hn::Set(d, 0.8493218002880191), hn::Exp(d, hn::Neg(log_lengthscale)));
    hn::Store(factor, d, factors + f * kTileLanes);
    for (int i = 0; i < shape.n_points; ++i) {
      const int at = (i * shape.n_inputs + f) * kTileLanes;
      hn::Store(hn::Mul(factor, hn::Load(d, points + at)), d, scaled + at);
    }
  }
}

// The Cholesky factor of K + 0.01 I, row after row of its lower triangle, a vector an entry; the
// diagonal holds reciprocals.
void Factorise(const GpPolicyShape& shape, const double* HWY_RESTRICT scaled, double* triangle) {
  const D d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  double* row_i = triangle;
  for (int i = 0; i < shape.n_points; ++i) {
    const double* HWY_RESTRICT z_i = scaled + i * shape.n_inputs * kTileLanes;
    V diagonal = hn::Set(d, 1 + kGpPolicyNoise);
    const double* row_j = triangle;
    for (int j = 0; j < i; ++j) {
      const double* HWY_RESTRICT z_j = scaled + j * shape.n_inputs * kTileLanes;
      V covariance[1] = {hn::Zero(d)};
      for (int f = 0; f < shape.n_inputs; ++f) {
        const V difference =
            hn::Sub(hn::Load(d, z_i + f * kTileLanes), hn::Load(d, z_j + f * kTileLanes));
        covariance[0] = hn::MulAdd(difference, difference, covariance[0]);
      }
      Exp2Negative(d, covariance);
      V sum = covariance[0];
      for (int k = 0; k < j; ++k) {
        sum = hn::NegMulAdd(hn::Load(d, row_i + k * lanes), hn::Load(d, row_j + k * lanes), sum);
      }
      const V entry = hn::Mul(sum, hn::Load(d, row_j + j * lanes));
      diagonal = hn::NegMulAdd(entry, entry, diagonal);
      hn::Store(entry, d, row_i + j * lanes);
      row_j += (j + 1) * lanes;
    }
    hn::Store(hn::Div(hn::Set(d, 1.0), hn::Sqrt(diagonal)), d, row_i + i * lanes);
    row_i += (i + 1) * lanes;
  }
}

// alpha = L^-T L^-1 p.
void Solve(int n_points, const double* HWY_RESTRICT triangle, const double* HWY_RESTRICT targets,
           double* HWY_RESTRICT alpha) {
  const D d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const double* HWY_RESTRICT row = triangle;
  for (int i = 0; i < n_points; ++i) {
    V sum = hn::Load(d, targets + i * kTileLanes);
    for (int j = 0; j < i; ++j) {
      sum = hn::NegMulAdd(hn::Load(d, row + j * lanes), hn::Load(d, alpha + j * kTileLanes), sum);
    }
    hn::Store(hn::Mul(sum, hn::Load(d, row + i * lanes)), d, alpha + i * kTileLanes);
    row += (i + 1) * lanes;
  }
  for (int i = n_points - 1; i >= 0; --i) {
    row -= (i + 1) * lanes;
    const V solved = hn::Mul(hn::Load(d, alpha + i * kTileLanes), hn::Load(d, row + i * lanes));
    hn::Store(solved, d, alpha + i * kTileLanes);
    for (int j = 0; j < i; ++j) {
      double* HWY_RESTRICT entry = alpha + j * kTileLanes;
      hn::Store(hn::NegMulAdd(hn::Load(d, row + j * lanes), solved, hn::Load(d, entry)), d, entry);
    }
  }
}

void GpPolicyPrepare(const GpPolicyShape& shape, int n_lanes, const double* HWY_RESTRICT parameters,
                     double* HWY_RESTRICT scratch) {
  const D d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const double* targets = parameters + shape.n_points * shape.n_inputs * kTileLanes;
  const double* log_lengthscales = targets + shape.n_outputs * shape.n_points * kTileLanes;
  double* const triangle = scratch + shape.n_outputs * shape.prepared_rows() * kTileLanes;
  for (int o = 0; o < shape.n_outputs; ++o) {
    double* const factors = scratch + o * shape.prepared_rows() * kTileLanes;
    double* const scaled = factors + shape.n_inputs * kTileLanes;
    double* const alpha = scaled + shape.n_points * shape.n_inputs * kTileLanes;
    for (int lane = 0; lane < n_lanes; lane += lanes) {
      ScalePoints(shape, parameters + lane,
                  log_lengthscales + o * shape.n_inputs * kTileLanes + lane, factors + lane,
                  scaled + lane);
      Factorise(shape, scaled + lane, triangle);
      Solve(shape.n_points, triangle, targets + o * shape.n_points * kTileLanes + lane,
            alpha + lane);
    }
  }
}

// One output for kTogether vectors of lanes.
void Output(const GpPolicyShape& shape, const double* HWY_RESTRICT prepared,
            const double* HWY_RESTRICT input_scale, double limit, const double* HWY_RESTRICT inputs,
            double* HWY_RESTRICT scaled_inputs, double* HWY_RESTRICT output) {
  const D d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const double* HWY_RESTRICT z = prepared + shape.n_inputs * kTileLanes;
  const double* HWY_RESTRICT alpha = z + shape.n_points * shape.n_inputs * kTileLanes;
  for (int f = 0; f < shape.n_inputs; ++f) {
    for (int t = 0; t < kTogether; ++t) {
      const int at = f * kTileLanes + t * lanes;
      const V factor = hn::Mul(hn::Set(d, input_scale[f]), hn::Load(d, prepared + at));
      hn::Store(hn::Mul(factor, hn::Load(d, inputs + at)), d, scaled_inputs + at);
    }
  }
  V mean[kTogether];
  for (V& m : mean) m = hn::Zero(d);
  for (int i = 0; i < shape.n_points; ++i) {
    V covariance[kTogether];
    for (V& c : covariance) c = hn::Zero(d);
    for (int f = 0; f < shape.n_inputs; ++f, z += kTileLanes) {
      for (int t = 0; t < kTogether; ++t) {
        const V difference = hn::Sub(hn::Load(d, scaled_inputs + f * kTileLanes + t * lanes),
                                     hn::Load(d, z + t * lanes));
        covariance[t] = hn::MulAdd(difference, difference, covariance[t]);
      }
    }
    Exp2Negative(d, covariance);
    for (int t = 0; t < kTogether; ++t) {
      const V weight = hn::Load(d, alpha + i * kTileLanes + t * lanes);
      mean[t] = hn::MulAdd(covariance[t], weight, mean[t]);
    }
  }
  for (int t = 0; t < kTogether; ++t) {
    hn::Store(hn::Mul(hn::Set(d, limit), Squash(d, mean[t])), d, output + t * lanes);
  }
}

void GpPolicy(const GpPolicyShape& shape, int n_lanes, const double* HWY_RESTRICT input_scale,
              const double* HWY_RESTRICT limits, const double* HWY_RESTRICT inputs,
              double* HWY_RESTRICT scratch, double* HWY_RESTRICT outputs) {
  const D d;
  const int together = kTogether * static_cast<int>(hn::Lanes(d));
  const int prepared = shape.prepared_rows() * kTileLanes;
  double* const scaled_inputs = scratch + shape.n_outputs * prepared;
  for (int o = 0; o < shape.n_outputs; ++o) {
    for (int lane = 0; lane < n_lanes; lane += together) {
      Output(shape, scratch + o * prepared + lane, input_scale, limits[o], inputs + lane,
             scaled_inputs + lane, outputs + o * kTileLanes + lane);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(GpPolicyPrepare);
HWY_EXPORT(GpPolicy);

void GpPolicyPrepareTile(const GpPolicyShape& shape, int n_lanes, const double* parameters,
                         double* scratch) {
  HWY_DYNAMIC_DISPATCH(GpPolicyPrepare)(shape, n_lanes, parameters, scratch);
}

void GpPolicyTile(const GpPolicyShape& shape, int n_lanes, const double* input_scale,
                  const double* limits, const double* inputs, double* scratch, double* outputs) {
  HWY_DYNAMIC_DISPATCH(GpPolicy)(shape, n_lanes, input_scale, limits, inputs, scratch, outputs);
}

}  // namespace downpour
#endif  // HWY_ONCE
