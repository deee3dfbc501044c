// SPDX-License-Identifier: Apache-2.0
#include "engine/eigen.h"

#include <doctest/doctest.h>

#include "engine/errors.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

Dataset PendulumData() {
  const Eigen::MatrixXd inputs = Eigen::ArrayXXd::Random(30, 4);
  return {inputs, 0.1 * inputs.leftCols(2).array().sin()};
}

TEST_CASE("eigen: predictions have the bits of the spans' call, from either storage order") {
  const MultiOutputGp gp = MultiOutputGp::Fit(PendulumData(), {}, 0, 1);
  const Eigen::MatrixXd queries = Eigen::MatrixXd::Random(51, 4);
  const RowMajorMatrix rows = queries;
  std::vector<double> means(102), variances(102);
  gp.Predict({rows.data(), 204}, true, 1, means, variances);
  for (const Prediction& prediction : {Predict(gp, queries, true), Predict(gp, rows, true, 2)}) {
    for (int i = 0; i < 102; ++i) {
      CHECK(prediction.means.data()[i] == means[i]);
      CHECK(prediction.variances.data()[i] == variances[i]);
    }
  }
  CHECK_THROWS_AS(Predict(gp, queries.leftCols(3), true), InvalidInput);
}

TEST_CASE("eigen: returns are those of the spans' call, a row a parameter vector") {
  const auto model = std::make_shared<MultiOutputGp>(MultiOutputGp::Fit(PendulumData(), {}, 0, 1));
  const Task task = MakeTask("pendulum");
  const std::shared_ptr<const Policy> policy = MakePolicy(task, {});
  const ModelEvaluator evaluator(model, task, policy, {}, 3, {});
  const RowMajorMatrix parameters = RowMajorMatrix::Random(5, policy->n_parameters());
  std::vector<double> returns(15);
  evaluator.Evaluate({parameters.data(), static_cast<std::size_t>(parameters.size())},
                     policy->n_parameters(), 4, returns);
  const RowMajorMatrix matrix = Evaluate(evaluator, parameters, 4);
  CHECK(matrix.rows() == 5);
  for (int i = 0; i < 15; ++i) CHECK(matrix(i / 3, i % 3) == returns[i]);
}

TEST_CASE("eigen: ask and tell are the minimiser's") {
  MinimiseOptions options;
  options.lower = {-1, -1};
  options.upper = {1, 1};
  Minimiser by_spans(options), by_eigen(options);
  for (int generation = 0; generation < 5; ++generation) {
    const auto x = Ask(&by_eigen);
    CHECK(x.rows() == by_eigen.population());
    const std::span<const double> candidates = by_spans.Ask();
    for (int i = 0; i < x.size(); ++i) CHECK(x.data()[i] == candidates[i]);
    const Eigen::VectorXd costs = x.rowwise().squaredNorm();
    Tell(&by_eigen, costs);
    by_spans.Tell({costs.data(), static_cast<std::size_t>(costs.size())});
  }
}

}  // namespace
}  // namespace downpour
