// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/planned_model.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// n points in [-1, 1]^2 times `width`.
Eigen::MatrixXd Points(int n, double width, std::uint32_t key) {
  Eigen::MatrixXd x(n, 2);
  FillUniforms({key, 5}, 0, x.data(), static_cast<std::size_t>(x.size()));
  return width * (2 * x.array() - 1);
}

// A smooth and a rough function of 120 points.
std::vector<ExactGp> Gps() {
  const Eigen::MatrixXd x = Points(120, 1, 1);
  const Eigen::VectorXd y = (2 * x.col(0).array()).sin() + x.col(1).array();
  return {ExactGp(x, y, {{2, 2}, 1, 0.05}), ExactGp(x, y, {{0.2, 0.2}, 1, 0.05})};
}

TEST_CASE("planned_model: plans hold the tolerances, and what a check finds is remembered") {
  const QueryPlanOptions options;
  PlannedModel model(Gps(), options, 1);
  model.Choose(Points(500, 1, 2));
  REQUIRE(model.plans().size() == 2);
  CHECK(model.plans()[0].compressed);
  CHECK(model.plans()[0].points < 60);
  CHECK(model.Check(Points(500, 1, 3)) == 0);
  for (int e = 0; e < 2; ++e) {
    CHECK(model.errors()[e].variance >= model.plans()[e].probe_errors.variance);
    CHECK(model.errors()[e].variance <= options.variance_tolerance);
    CHECK(model.errors()[e].mean <= options.mean_tolerance);
  }
}

TEST_CASE("planned_model: inputs on which a plan fails make it stricter") {
  // Probes at a single place say nothing of the rest.
  PlannedModel model(Gps(), {}, 1);
  model.Choose(Points(50, 1e-3, 4));
  const int before = model.plans()[0].points;
  const Eigen::MatrixXd met = Points(500, 2, 5);
  REQUIRE(model.Check(met) > 0);
  CHECK(model.plans()[0].points >= before);
  CHECK(model.Check(met) == 0);
}

TEST_CASE("planned_model: tolerance 0 is the exact posterior in fp64, which no check changes") {
  QueryPlanOptions options;
  options.variance_tolerance = options.mean_tolerance = 0;
  PlannedModel model(Gps(), options, 1);
  model.Choose(Points(100, 1, 6));
  CHECK(model.Check(Points(100, 3, 7)) == 0);
  for (const OutputPlan& plan : model.plans()) {
    CHECK_FALSE(plan.compressed);
    CHECK_FALSE(plan.single_precision);
    CHECK(plan.points == 120);
  }
}

TEST_CASE("planned_model: by BLAS, plans are exact and a check tells the difference from fused") {
  const QueryPlanOptions options{.backend = QueryBackend::kBlas};
  PlannedModel model(Gps(), options, 1);
  model.Choose(Points(100, 1, 6));
  CHECK(model.Check(Points(100, 3, 7)) == 0);
  // Factors carry eps times the condition number, and errors are shares of the noise at least.
  const double ratio = 1 / 0.05;
  const double bound = std::numeric_limits<double>::epsilon() * 120 * std::pow(ratio, 4);
  for (int e = 0; e < 2; ++e) {
    CHECK(model.plans()[e].backend() == QueryBackend::kBlas);
    CHECK(std::holds_alternative<BlasFactor>(model.factors()[e]));
    CHECK(model.plans()[e].points == 120);
    CHECK(model.errors()[e].variance > 0);
    CHECK(model.errors()[e].variance <= bound);
    CHECK(model.errors()[e].mean <= bound);
  }
}

TEST_CASE("planned_model: every output's queries are timed") {
  PlannedModel model(Gps(), {}, 1);
  model.Choose(Points(20, 1, 9));  // fewer probes than a tile has lanes
  const std::vector<double> nanoseconds = model.TimeQueries();
  REQUIRE(nanoseconds.size() == 2);
  for (const double time : nanoseconds) {
    CHECK(time > 0);
    CHECK(time < 1e9);
  }
}

TEST_CASE("planned_model: the plans do not depend on the number of threads") {
  PlannedModel one(Gps(), {}, 1), many(Gps(), {}, 5);
  one.Choose(Points(500, 1, 8));
  many.Choose(Points(500, 1, 8));
  for (int e = 0; e < 2; ++e) {
    CHECK(one.plans()[e].points == many.plans()[e].points);
    CHECK(one.plans()[e].probe_errors.variance == many.plans()[e].probe_errors.variance);
  }
}

}  // namespace
}  // namespace downpour
