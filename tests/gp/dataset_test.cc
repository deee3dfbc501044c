// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/dataset.h"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "engine/errors.h"
#include "engine/gp/gp_model.h"
#include "engine/gp/query_plan.h"

namespace downpour {
namespace {

TEST_CASE("dataset: rows of numbers become rows of matrices") {
  const std::vector<double> inputs = {1, 2, 3, 4, 5, 6}, targets = {7, 8};
  const Dataset data = MakeDataset(inputs, 3, targets, 1);
  CHECK(data.n_points() == 2);
  CHECK(data.inputs == Eigen::MatrixXd{{1, 2, 3}, {4, 5, 6}});
  CHECK(data.targets == Eigen::MatrixXd{{7}, {8}});
}

TEST_CASE("dataset: sizes that disagree and numbers that are not finite are refused") {
  std::vector<double> inputs = {1, 2, 3, 4}, targets = {7, 8};
  CHECK_THROWS_AS(MakeDataset(inputs, 3, targets, 1), InvalidInput);
  CHECK_THROWS_AS(MakeDataset(inputs, 2, targets, 2), InvalidInput);
  CHECK_THROWS_AS(MakeDataset(inputs, 0, targets, 1), InvalidInput);
  CHECK_THROWS_AS(MakeDataset(inputs, 2, targets, -1), InvalidInput);
  CHECK_THROWS_AS(MakeDataset({}, 2, {}, 1), InvalidInput);
  inputs[3] = std::numeric_limits<double>::infinity();
  CHECK_THROWS_AS(MakeDataset(inputs, 2, targets, 1), InvalidInput);
}

// 30 points on a curve in the plane, row-major.
struct Curve {
  Curve() {
    for (int i = 0; i < 30; ++i) {
      inputs.insert(inputs.end(), {std::sin(0.3 * i), std::cos(0.5 * i)});
      targets.push_back(std::sin(0.7 * i));
    }
  }
  std::vector<double> inputs, targets;
  Hyperparameters hyper{{0.8, 1.2}, 1.1, 0.05};
};

TEST_CASE("dataset: one output's posterior from spans has the bits of that from matrices") {
  const Curve c;
  const Dataset data = MakeDataset(c.inputs, 2, c.targets, 1);
  const ExactGp by_matrices(data.inputs, data.targets.col(0), c.hyper);
  const std::span inputs(c.inputs), targets(c.targets);
  const ExactGp whole(inputs, 2, targets, c.hyper);
  const ExactGp first(inputs.first(40), 2, targets.first(20), c.hyper);
  const ExactGp in_two = first.Append(inputs.subspan(40), 2, targets.subspan(20));
  CHECK(in_two.inputs() == data.inputs);
  const ExactGp two_by_matrices =
      ExactGp(data.inputs.topRows(20), data.targets.col(0).head(20), c.hyper)
          .Append(data.inputs.bottomRows(10), data.targets.col(0).tail(10));
  const std::array query = {0.2, -0.4};
  const auto check = [&](const ExactGp& a, const ExactGp& b) {
    double mean = 0, variance = 0, wanted_mean = 0, wanted_variance = 0;
    b.Predict(Eigen::Vector2d(query[0], query[1]), &wanted_mean, &wanted_variance);
    a.Predict(query, false, &mean, &variance);
    CHECK(mean == wanted_mean);
    CHECK(variance == wanted_variance);
    a.Predict(query, true, &mean, &variance);
    CHECK(variance == wanted_variance + c.hyper.noise_std * c.hyper.noise_std);
  };
  check(whole, by_matrices);
  check(in_two, two_by_matrices);
  CHECK_THROWS_AS(ExactGp(inputs.first(39), 2, targets.first(20), c.hyper), InvalidInput);
  CHECK_THROWS_AS(first.Append(inputs.first(3), 2, targets.first(2)), InvalidInput);
  CHECK_THROWS_AS(first.Append(inputs.first(3), 3, targets.first(1)), InvalidInput);
  double unused = 0;
  CHECK_THROWS_AS(whole.Predict(inputs.first(1), true, &unused, &unused), InvalidInput);
}

TEST_CASE("dataset: plans on spans are those on matrices") {
  const Curve c;
  const Dataset data = MakeDataset(c.inputs, 2, c.targets, 1);
  const ExactGp exact(c.inputs, 2, c.targets, c.hyper);
  const OutputPlan plan = ChoosePlan(exact, c.inputs, 2, {});
  const OutputPlan wanted = ChoosePlan(exact, data.inputs, {});
  CHECK(plan.points == wanted.points);
  CHECK(plan.tau == wanted.tau);
  CHECK(plan.probe_errors.variance == wanted.probe_errors.variance);
  const GpFactor packed = exact.Pack();
  const PlanErrors errors = MeasurePlan(plan, packed, c.inputs, 2);
  CHECK(errors.variance == MeasurePlan(plan, packed, data.inputs).variance);
  CHECK(ChoosePlan(exact, {}, 2, {}).relative_cost == 1);  // no probes: exact
  CHECK_THROWS_AS(ChoosePlan(exact, std::span(c.inputs).first(59), 2, {}), InvalidInput);
  CHECK_THROWS_AS(ChoosePlan(exact, c.inputs, 3, {}), InvalidInput);
  CHECK_THROWS_AS(MeasurePlan(plan, packed, c.inputs, 0), InvalidInput);
}

}  // namespace
}  // namespace downpour
