// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/blas_query.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "engine/gp/query_plan.h"
#include "tests/gp/cartpole_reference.h"
#include "tests/gp/reference_gp.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

ExactGp RandomGp(int n, int dim) {
  return ExactGp(RandomMatrix(n, dim, n), RandomMatrix(n, 1, n + 1000),
                 {std::vector<double>(dim, 1.5), 1.2, 0.1});
}

// Tiles of inputs with a gap between them, and room for the answers.
struct Batch {
  int n_tiles, dim;
  std::size_t stride;
  AlignedVector<double> x, mean, variance;
  Batch(int n_tiles, int dim, std::uint32_t stream)
      : n_tiles(n_tiles), dim(dim), stride((dim + 2) * kTileLanes), x(n_tiles * stride) {
    FillNormals({stream, 78}, 0, x.data(), x.size());
    mean.assign(x.size(), -7);
    variance.assign(x.size(), -7);
  }
  double& At(int tile, int d, int lane) { return x[tile * stride + d * kTileLanes + lane]; }
  void Query(const BlasFactor& factor, bool with_variance = true) {
    AlignedVector<char> scratch(BlasQueryScratchBytes(factor, n_tiles), char(0xFF));  // NaN
    BlasQuery(factor, n_tiles, stride, x.data(), scratch.data(), mean.data(),
              with_variance ? variance.data() : nullptr);
  }
};

// Exact arithmetic on the factor for one query, and the scales of the error bounds (blas_query.h).
struct Reference {
  long double mean = 0, variance = 0, mean_absolute = 0, norm_absolute = 0;
  Reference(const BlasFactor& f, const std::vector<double>& x) : variance(f.signal_variance) {
    std::vector<long double> e(f.n), spread(f.n);
    for (int i = 0; i < f.n; ++i) {
      long double exponent = 0, magnitude = 0;
      for (int d = 0; d < f.dim; ++d) {
        const long double scaled = static_cast<long double>(f.scale[d]) * x[d];
        const long double a = scaled - f.centre[d], b = f.inputs[i * f.dim + d];
        exponent += (a - b) * (a - b);
        magnitude += std::abs(a - b) * (std::abs(a) + std::abs(b) + std::abs(scaled));
      }
      e[i] = std::exp2(-exponent);
      spread[i] = e[i] * (1 + exponent + magnitude);
      mean += f.weights[i] * e[i];
      mean_absolute += std::abs(f.weights[i]) * spread[i];
    }
    for (int r = 0; r < f.n; ++r) {
      long double sum = 0, absolute = 0;
      for (int j = 0; j <= r; ++j) {
        const long double w = f.triangle[static_cast<std::size_t>(j) * f.n + r];
        sum += w * e[j];
        absolute += std::abs(w) * spread[j];
      }
      variance -= sum * sum;
      norm_absolute += std::abs(sum) * absolute;
    }
    variance = std::max(variance, 0.0L);
  }
};

TEST_CASE("blas_query: matches the long-double reference for every size of model and batch") {
  for (const int n : {1, 7, 8, 9, 320}) {
    for (const int n_tiles : {1, 2, kBlasTiles}) {
      const BlasFactor factor = MakeBlasFactor(RandomGp(n, 6));
      Batch batch(n_tiles, 6, n);
      batch.Query(factor);
      const long double unit = (n + 6 + 4) * kEps;
      double worst = 0;
      // Every 5th lane: the reference takes n^2 long-double steps.
      for (int q = 0; q < n_tiles * kTileLanes; q += 5) {
        const int tile = q / kTileLanes, lane = q % kTileLanes;
        std::vector<double> x(6);
        for (int d = 0; d < 6; ++d) x[d] = batch.At(tile, d, lane);
        const Reference want(factor, x);
        const std::size_t at = tile * batch.stride + lane;
        const long double mean = std::abs(batch.mean[at] - want.mean) / (unit * want.mean_absolute);
        const long double variance = std::abs(batch.variance[at] - want.variance) /
                                     (unit * (factor.signal_variance + 2 * want.norm_absolute));
        // Written so that NaN counts as wrong.
        if (!(mean <= worst)) worst = static_cast<double>(mean);
        if (!(variance <= worst)) worst = static_cast<double>(variance);
      }
      CAPTURE(n);
      CAPTURE(n_tiles);
      CHECK(worst <= 1);
    }
  }
}

TEST_CASE("blas_query: predictions on cart-pole data match the 80-bit reference") {
  const CartpoleReference ref;
  for (int e = 0; e < 4; ++e) {
    CAPTURE(e);
    const ExactGp gp(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const BlasFactor factor = MakeBlasFactor(gp);
    Batch batch(1, 6, 1);
    for (int lane = 0; lane < kTileLanes; ++lane) {
      for (int d = 0; d < 6; ++d) batch.At(0, d, lane) = ref.query(lane, d);
    }
    batch.Query(factor);
    // The factor carries a relative error of eps times the condition number.
    const double unit = kEps * ConditionBound(ref.hyper[e], 160);
    const double magnitude = gp.alpha().cwiseAbs().sum() * factor.signal_variance;
    for (int lane = 0; lane < kTileLanes; ++lane) {
      CHECK(std::abs(batch.mean[lane] - ref.mean(lane, e)) <= unit * magnitude);
      CHECK(std::abs(batch.variance[lane] - ref.variance(lane, e)) <=
            unit * factor.signal_variance);
    }
  }
}

TEST_CASE("blas_query: writes the answers and nothing between the tiles") {
  const BlasFactor factor = MakeBlasFactor(RandomGp(20, 3));
  Batch batch(3, 3, 1);
  batch.Query(factor);
  for (std::size_t at = 0; at < batch.mean.size(); ++at) {
    const bool answer = at % batch.stride < kTileLanes;
    CHECK((batch.mean[at] != -7) == answer);
    CHECK((batch.variance[at] != -7) == answer);
  }
}

TEST_CASE("blas_query: mean only gives the same mean") {
  const BlasFactor factor = MakeBlasFactor(RandomGp(37, 3));
  Batch both(2, 3, 1), alone(2, 3, 1);
  both.Query(factor);
  alone.Query(factor, false);
  CHECK(alone.mean == both.mean);
}

TEST_CASE("blas_query: a query that is not finite spoils its own lane only") {
  const BlasFactor factor = MakeBlasFactor(RandomGp(40, 3));
  Batch clean(3, 3, 1);
  clean.Query(factor);
  for (const double bad : {std::nan(""), HUGE_VAL, -HUGE_VAL}) {
    Batch spoilt(3, 3, 1);
    spoilt.At(1, 2, 20) = bad;
    spoilt.Query(factor);
    const std::size_t own = spoilt.stride + 20;
    for (std::size_t at = 0; at < clean.mean.size(); ++at) {
      if (at == own) {
        CHECK(std::isnan(spoilt.mean[at]));
        CHECK(std::isnan(spoilt.variance[at]));
      } else {
        CHECK(spoilt.mean[at] == clean.mean[at]);
        CHECK(spoilt.variance[at] == clean.variance[at]);
      }
    }
  }
}

TEST_CASE("blas_query: far from the data the prior comes back exactly") {
  const BlasFactor factor = MakeBlasFactor(RandomGp(40, 3));
  Batch batch(1, 3, 1);
  for (double& x : batch.x) x = 1e6;
  batch.Query(factor);
  for (int lane = 0; lane < kTileLanes; ++lane) {
    CHECK(batch.mean[lane] == 0);
    CHECK(batch.variance[lane] == factor.signal_variance);
  }
}

TEST_CASE("blas_query: a plan by BLAS is exact whatever the tolerances, and agrees with fused") {
  const ExactGp gp = RandomGp(160, 3);
  const Eigen::MatrixXd probes = RandomMatrix(500, 3, 9);
  const OutputPlan plan = ChoosePlan(gp, probes, {1, 1, QueryBackend::kBlas});
  CHECK(plan.backend() == QueryBackend::kBlas);
  CHECK_FALSE(plan.compressed);
  CHECK_FALSE(plan.single_precision);
  CHECK(plan.points == 160);
  CHECK(plan.relative_cost == 1);
  CHECK(ChoosePlan(gp, probes, {0, 0}).backend() == QueryBackend::kFused);
  // Both work on factors with a relative error of eps times the condition number, and divide by
  // the noise variance at least.
  const double unit = kEps * ConditionBound(gp.hyperparameters(), 160);
  const double ratio = gp.hyperparameters().signal_std / gp.hyperparameters().noise_std;
  const PlanErrors errors = MeasurePlan(plan, gp.Pack(), probes);
  CHECK(errors.variance <= unit * ratio * ratio);
  CHECK(errors.mean <= unit * ratio * gp.alpha().cwiseAbs().sum());
  CHECK(errors.variance > 0);  // two ways of rounding: nothing was compared with itself
}

}  // namespace
}  // namespace downpour
