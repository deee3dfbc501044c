// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/query_plan.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>
#include <variant>

#include "engine/errors.h"
#include "tests/gp/cartpole_reference.h"
#include "tests/gp/factor_answers.h"
#include "tests/gp/reference_gp.h"

namespace downpour {
namespace {

// Each row of `inputs` `times` times, moved by `size` column standard deviations of normal noise.
Eigen::MatrixXd Perturbed(const Eigen::MatrixXd& inputs, int times, double size,
                          std::uint32_t stream) {
  const Eigen::MatrixXd centred = inputs.rowwise() - inputs.colwise().mean();
  const Eigen::RowVectorXd std =
      (centred.colwise().squaredNorm() / static_cast<double>(inputs.rows())).cwiseSqrt();
  const Eigen::MatrixXd noise = RandomMatrix(inputs.rows() * times, inputs.cols(), stream);
  return inputs.replicate(times, 1) + size * (noise.array().rowwise() * std.array()).matrix();
}

Eigen::MatrixXd Stacked(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  Eigen::MatrixXd stacked(a.rows() + b.rows(), a.cols());
  stacked << a, b;
  return stacked;
}

// Worst errors against ExactGp::Predict, which solves with L and knows no tiles.
PlanErrors BruteForceErrors(const OutputPlan& plan, const ExactGp& exact,
                            const Eigen::MatrixXd& inputs) {
  const Eigen::MatrixXd answers = Answers(plan.factor, inputs);
  const double noise_variance = std::pow(exact.hyperparameters().noise_std, 2);
  PlanErrors worst;
  for (Eigen::Index i = 0; i < inputs.rows(); ++i) {
    double mean = 0, variance = 0;
    exact.Predict(inputs.row(i), &mean, &variance);
    const double predictive = variance + noise_variance;
    worst.variance = std::max(worst.variance, std::abs(answers(i, 1) - variance) / predictive);
    worst.mean = std::max(worst.mean, std::abs(answers(i, 0) - mean) / std::sqrt(predictive));
  }
  return worst;
}

TEST_CASE("query_plan: tolerance 0 and no probes are exact fp64") {
  const CartpoleReference ref;
  const ExactGp exact(ref.data.inputs, ref.data.targets.col(1), ref.hyper[1]);
  const Eigen::MatrixXd& x = ref.data.inputs;
  for (const OutputPlan& plan : {ChoosePlan(exact, x, {0, 0.05}), ChoosePlan(exact, x, {0.02, 0}),
                                 ChoosePlan(exact, Eigen::MatrixXd(0, 6), {})}) {
    CHECK_FALSE(plan.compressed);
    CHECK_FALSE(plan.single_precision);
    CHECK(plan.n == 160);
    CHECK(plan.points == 160);
    CHECK(plan.relative_cost == 1);
    CHECK(std::get<GpFactor>(plan.factor).triangle == exact.Pack().triangle);
    const PlanErrors errors = MeasurePlan(plan, exact.Pack(), ref.query);
    CHECK(errors.variance == 0);
    CHECK(errors.mean == 0);
  }
}

TEST_CASE("query_plan: errors on fresh inputs of cart-pole models stay under the tolerance") {
  const CartpoleReference ref;
  const Eigen::MatrixXd& x = ref.data.inputs;
  const Eigen::MatrixXd probes = Stacked(x, Perturbed(x, 10, 0.2, 1));
  const Eigen::MatrixXd fresh = Perturbed(x, 10, 0.2, 2);
  for (int e = 0; e < 4; ++e) {
    const ExactGp exact(x, ref.data.targets.col(e), ref.hyper[e]);
    double last_cost = 0;
    for (const double scale : {5.0, 1.0, 0.1, 0.0}) {
      CAPTURE(e);
      CAPTURE(scale);
      const QueryPlanOptions options{0.02 * scale, 0.05 * scale};
      const OutputPlan plan = ChoosePlan(exact, probes, options);
      CHECK(plan.probe_errors.variance <= options.variance_tolerance / 2);
      CHECK(plan.probe_errors.mean <= options.mean_tolerance / 2);
      const PlanErrors errors = MeasurePlan(plan, exact.Pack(), fresh);
      CHECK(errors.variance <= options.variance_tolerance);
      CHECK(errors.mean <= options.mean_tolerance);
      // A stricter tolerance never makes it cheaper.
      CHECK(plan.relative_cost >= last_cost);
      CHECK(plan.relative_cost <= 1);
      last_cost = plan.relative_cost;
      CheckSound(plan.factor, ref.query);
      if (plan.compressed) CHECK(plan.points <= plan.n);
    }
    CHECK(last_cost == 1);
  }
}

TEST_CASE("query_plan: measured errors are those of a triangular solve for each query") {
  const CartpoleReference ref;
  for (int e = 0; e < 4; ++e) {
    CAPTURE(e);
    const ExactGp exact(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const OutputPlan plan = ChoosePlan(exact, ref.data.inputs, {1, 1});
    const double unit =
        160 * std::numeric_limits<double>::epsilon() * ConditionBound(ref.hyper[e], 160);
    const auto check = [&](const Eigen::MatrixXd& inputs) {
      const PlanErrors errors = MeasurePlan(plan, exact.Pack(), inputs);
      const PlanErrors expected = BruteForceErrors(plan, exact, inputs);
      CHECK(std::abs(errors.variance - expected.variance) <= unit);
      CHECK(std::abs(errors.mean - expected.mean) <= unit);
    };
    check(ref.query.topRows(49));  // one full tile and one lane
    for (int q = 0; q < 50; ++q) check(ref.query.row(q));
    CHECK(MeasurePlan(plan, exact.Pack(), ref.query).variance > 0);
  }
}

TEST_CASE("query_plan: synthetic models of all sizes and noise ratios meet the tolerance") {
  const QueryPlanOptions options;
  for (const int n : {1, 2, 9, 40, 120, 300}) {
    for (const double ratio : {1.0, 10.0, 100.0, 1000.0}) {
      CAPTURE(n);
      CAPTURE(ratio);
      const Eigen::MatrixXd x = RandomMatrix(n, 3, n);
      const Hyperparameters hyper{{1.0, 2.0, 3.0}, 1.0, 1 / ratio};
      const ExactGp exact(x, DrawTargets(x, hyper, n + 7), hyper);
      const Eigen::MatrixXd probes = Stacked(x, RandomMatrix(2000, 3, 501));
      const OutputPlan plan = ChoosePlan(exact, probes, options);
      const Eigen::MatrixXd fresh = RandomMatrix(2000, 3, 502);
      const PlanErrors errors = MeasurePlan(plan, exact.Pack(), fresh);
      CHECK(errors.variance <= options.variance_tolerance);
      CHECK(errors.mean <= options.mean_tolerance);
      CheckSound(plan.factor, fresh.topRows(200));
      if (n == 300 && ratio <= 100) CHECK(plan.relative_cost < 0.5);
    }
  }
}

TEST_CASE("query_plan: wide signal-to-noise ratios refuse single precision, narrow ones take it") {
  const Eigen::MatrixXd x = RandomMatrix(100, 2, 11);
  const Hyperparameters wide{{2.0, 2.0}, 1.0, 1e-4}, narrow{{2.0, 2.0}, 1.0, 0.1};
  const OutputPlan wide_plan = ChoosePlan(ExactGp(x, DrawTargets(x, wide, 12), wide), x, {});
  CHECK_FALSE(wide_plan.single_precision);
  CHECK(wide_plan.compressed);
  const OutputPlan narrow_plan = ChoosePlan(ExactGp(x, DrawTargets(x, narrow, 12), narrow), x, {});
  CHECK(narrow_plan.single_precision);
  CHECK(narrow_plan.compressed);
  CHECK(narrow_plan.points < wide_plan.points);
}

TEST_CASE("query_plan: no negative variance or NaN on degenerate data and far away") {
  const Eigen::MatrixXd x = RandomMatrix(30, 2, 21);
  Eigen::MatrixXd duplicated(60, 2);
  duplicated << x, x;
  const Eigen::MatrixXd equal = Eigen::MatrixXd::Constant(30, 2, 0.7);
  const double lower_bound = 1e-6;  // of sigma_n / rms y in FitHyperparameters
  for (const double noise : {0.1, lower_bound, 1e-12}) {
    for (const Eigen::MatrixXd& inputs : {x, duplicated, equal, x.topRows(1).eval()}) {
      CAPTURE(noise);
      CAPTURE(inputs.rows());
      const Eigen::VectorXd y = RandomMatrix(inputs.rows(), 1, 22);
      const ExactGp exact(inputs, y, {{1.0, 0.5}, 10.0, noise});
      // Probes and queries at the points, around them and 10^3 length-scales away.
      const Eigen::MatrixXd around = Perturbed(x, 5, 1, 23);
      const Eigen::MatrixXd probes = Stacked(Stacked(inputs, around), around * 1e3);
      const OutputPlan plan = ChoosePlan(exact, probes, QueryPlanOptions());
      CheckSound(plan.factor, probes);
      const PlanErrors errors = MeasurePlan(plan, exact.Pack(), probes);
      CHECK(errors.variance <= 0.02);
      CHECK(errors.mean <= 0.05);
    }
  }
}

TEST_CASE("query_plan: the same model and probes give the same bits") {
  const CartpoleReference ref;
  const ExactGp exact(ref.data.inputs, ref.data.targets.col(3), ref.hyper[3]);
  const OutputPlan a = ChoosePlan(exact, ref.query, {}), b = ChoosePlan(exact, ref.query, {});
  CHECK(a.points == b.points);
  REQUIRE(a.factor.index() == b.factor.index());
  std::visit(
      [&](const auto& factor) {
        CHECK(factor.triangle == std::get<std::decay_t<decltype(factor)>>(b.factor).triangle);
      },
      a.factor);
}

TEST_CASE("query_plan: bad options and probes are refused by name") {
  const ExactGp exact(RandomMatrix(5, 2, 1), RandomMatrix(5, 1, 2), {{1.0, 1.0}, 1.0, 0.1});
  const Eigen::MatrixXd probes = RandomMatrix(5, 2, 3);
  CHECK_THROWS_WITH_AS(ChoosePlan(exact, probes, {-1, 0.05}),
                       "query plan: variance_tolerance is -1, must be in [0, 1]", InvalidInput);
  CHECK_THROWS_AS(ChoosePlan(exact, probes, {0.02, std::nan("")}), InvalidInput);
  CHECK_THROWS_WITH_AS(ChoosePlan(exact, RandomMatrix(5, 3, 3), {}),
                       "query plan: inputs have 3 columns, must be 2", InvalidInput);
  Eigen::MatrixXd bad = probes;
  bad(4, 1) = HUGE_VAL;
  CHECK_THROWS_WITH_AS(ChoosePlan(exact, bad, {}),
                       "query plan: input 4, column 1 is inf, must be finite", InvalidInput);
}

}  // namespace
}  // namespace downpour
