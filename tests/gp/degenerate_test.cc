// SPDX-License-Identifier: Apache-2.0
// Models that cancel most: whatever answers their queries, no answer is NaN and no variance is
// negative.
#include <doctest/doctest.h>

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "engine/gp/compression.h"
#include "engine/gp/gp_model.h"
#include "tests/gp/factor_answers.h"
#include "tests/gp/reference_gp.h"

namespace downpour {
namespace {

// sigma_n / rms y that learning may go down to (gp_model.h).
constexpr double kLeastNoise = 1e-6;

// Rows twice over.
Eigen::MatrixXd Twice(const Eigen::MatrixXd& x) { return x.replicate(2, 1); }

// Training inputs (D = 2) that make K as singular as it gets, by name.
std::vector<std::pair<std::string, Eigen::MatrixXd>> DegenerateInputs() {
  const Eigen::MatrixXd x = RandomMatrix(30, 2, 31);
  Eigen::MatrixXd nearly(60, 2), line(40, 2);
  nearly << x, x + 1e-9 * RandomMatrix(30, 2, 32);
  line.col(0).setLinSpaced(-1e-3, 1e-3);
  line.col(1) = line.col(0);
  return {{"one point", x.topRows(1)},
          {"one point twice", Twice(x.topRows(1))},
          {"equal points", Eigen::MatrixXd::Constant(50, 2, 0.7)},
          {"duplicates", Twice(x)},
          {"near duplicates", nearly},
          {"a short line", line}};
}

// The points, inputs around them, and inputs 10^3 and 10^6 length-scales (1) away along each axis,
// to both sides.
struct Queries {
  explicit Queries(const Eigen::MatrixXd& points)
      : near(3 * points.rows(), 2), far(8 * points.rows(), 2) {
    near << points, points + 1e-7 * RandomMatrix(points.rows(), 2, 33),
        points + RandomMatrix(points.rows(), 2, 34);
    int block = 0;
    for (const double distance : {-1e6, -1e3, 1e3, 1e6}) {
      for (int d = 0; d < 2; ++d) {
        auto rows = far.middleRows(block++ * points.rows(), points.rows());
        rows = points;
        rows.col(d).array() += distance;
      }
    }
  }
  Eigen::MatrixXd near, far;
};

// Every way to answer: the exact posterior and compressions of it, both in fp64 and fp32, and the
// exact one by OpenBLAS.
std::vector<QueryFactor> AllFactors(const ExactGp& exact) {
  const Compression compression(exact, 1e-4);
  std::vector<ReducedPosterior> posteriors = {ExactPosterior(exact)};
  for (const double tau : {1.0, 0.01, 1e-4}) {
    posteriors.push_back(compression.First(compression.PointsFor(tau)));
  }
  std::vector<QueryFactor> factors = {MakeBlasFactor(exact)};
  for (const ReducedPosterior& posterior : posteriors) {
    factors.emplace_back(PackPosterior<double>(exact, posterior));
    factors.emplace_back(PackPosterior<float>(exact, posterior));
  }
  return factors;
}

TEST_CASE("degenerate models: no factor gives a negative variance or NaN, near or far") {
  for (const auto& inputs : DegenerateInputs()) {
    const auto& name = inputs.first;
    const auto& x = inputs.second;
    for (const double noise : {0.1, kLeastNoise, 1e-12}) {
      CAPTURE(name);
      CAPTURE(noise);
      const Eigen::VectorXd y = RandomMatrix(x.rows(), 1, 35);
      const ExactGp exact(x, y, {{1.0, 1.0}, 10.0, noise});
      const Queries queries(x);
      for (const QueryFactor& factor : AllFactors(exact)) {
        CheckSound(factor, queries.near);
        // Nothing of the data reaches there: the prior.
        const Eigen::MatrixXd answers = Answers(factor, queries.far);
        CHECK((answers.col(0).array() == 0).all());
        CHECK((answers.col(1).array() == 100).all());
      }
    }
  }
}

TEST_CASE("degenerate models: what is learnt from them is sound, and so is its plan") {
  for (const auto& inputs : DegenerateInputs()) {
    const auto& name = inputs.first;
    const auto& x = inputs.second;
    Eigen::MatrixXd targets(x.rows(), 3);
    // A constant zero drives sigma_n to its lower bound.
    targets << x.col(0).array().sin() + 0.3 * x.col(1).array(), Eigen::VectorXd::Zero(x.rows()),
        RandomMatrix(x.rows(), 1, 36);
    for (const Eigen::VectorXd y : targets.colwise()) {
      CAPTURE(name);
      CAPTURE(y.norm());
      const Dataset data{x, y};
      const Hyperparameters hyper =
          FitHyperparameters(data, {}, {}, 0, 1, 1).front().hyperparameters;
      const ExactGp exact(x, y, hyper);
      const Queries queries(x);
      Eigen::MatrixXd probes(queries.near.rows() + queries.far.rows(), 2);
      probes << queries.near, queries.far;
      for (const QueryFactor& factor : AllFactors(exact)) CheckSound(factor, probes);
      const OutputPlan plan = ChoosePlan(exact, probes, {});
      CheckSound(plan.factor, probes);
      const PlanErrors errors = MeasurePlan(plan, exact.Pack(), probes);
      CHECK(errors.variance <= QueryPlanOptions().variance_tolerance);
      CHECK(errors.mean <= QueryPlanOptions().mean_tolerance);
    }
  }
}

TEST_CASE("degenerate models: a constant zero is learnt with sigma_n at its lower bound") {
  const Eigen::MatrixXd x = RandomMatrix(30, 2, 37);
  const Dataset data{x, Eigen::MatrixXd::Zero(30, 1)};
  const Hyperparameters hyper = FitHyperparameters(data, {}, {}, 0, 1, 1).front().hyperparameters;
  // rms y counts as 1e-12 at least.
  CHECK(std::abs(hyper.noise_std / (kLeastNoise * 1e-12) - 1) <= 0.01);
}

}  // namespace
}  // namespace downpour
