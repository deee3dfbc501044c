// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <vector>

#include "engine/errors.h"
#include "engine/gp/gp_model.h"
#include "engine/gp/likelihood.h"
#include "tests/gp/cartpole_reference.h"
#include "tests/gp/reference_gp.h"

namespace downpour {
namespace {

bool SameBits(const GpFit& a, const GpFit& b) {
  return a.hyperparameters.lengthscales == b.hyperparameters.lengthscales &&
         a.hyperparameters.signal_std == b.hyperparameters.signal_std &&
         a.hyperparameters.noise_std == b.hyperparameters.noise_std &&
         a.log_likelihood == b.log_likelihood && a.evaluations == b.evaluations;
}

bool IsFinite(const GpFit& fit) {
  bool finite = std::isfinite(fit.log_likelihood);
  for (const double p : LogParameters(fit.hyperparameters)) finite &= std::isfinite(p);
  return finite;
}

// Log likelihood less the curb, written out from its definition.
double Penalised(const Dataset& data, int output, const std::vector<double>& parameters) {
  const int dim = data.n_inputs();
  double value = LogLikelihood(data.inputs, data.targets.col(output))(parameters.data(), nullptr);
  for (int d = 0; d < dim; ++d) {
    const Eigen::ArrayXd x = data.inputs.col(d);
    const double std = std::sqrt((x - x.mean()).square().sum() / (data.n_points() - 1.0));
    value -= std::pow((parameters[d] - std::log(std)) / std::log(100.0), 30);
  }
  return value - std::pow((parameters[dim] - parameters[dim + 1]) / std::log(500.0), 30);
}

// No step of 0.05 in one parameter may improve the fit by more than `slack`.
void CheckIsMaximum(const Dataset& data, int output, const GpFit& fit, double slack) {
  const std::vector<double> optimum = LogParameters(fit.hyperparameters);
  const double best = Penalised(data, output, optimum);
  for (std::size_t p = 0; p < optimum.size(); ++p) {
    for (const double step : {-0.05, 0.05}) {
      CAPTURE(p);
      CAPTURE(step);
      std::vector<double> moved = optimum;
      moved[p] += step;
      CHECK(Penalised(data, output, moved) <= best + slack);
    }
  }
}

TEST_CASE("fit: recovers the hyper-parameters that data were drawn from") {
  for (std::uint32_t seed = 1; seed <= 3; ++seed) {
    CAPTURE(seed);
    const Hyperparameters truth{{0.8, 2.0}, 1.5, 0.1};
    const Eigen::MatrixXd x = 1.5 * RandomMatrix(150, 2, seed);
    const Dataset data{x, DrawTargets(x, truth, seed + 100)};
    const GpFit fit = FitHyperparameters(data, {}, {}, seed, 0, 1).at(0);
    const double at_truth =
        LogLikelihood(data.inputs, data.targets.col(0))(LogParameters(truth).data(), nullptr);
    CHECK(fit.log_likelihood >= at_truth);
    const std::vector<double> found = LogParameters(fit.hyperparameters);
    // Posterior spread at 150 points is about 0.15 for the lengthscales, 0.3 for the signal.
    for (int p = 0; p < 4; ++p) CHECK(std::abs(found[p] - LogParameters(truth)[p]) <= 0.7);
    CheckIsMaximum(data, 0, fit, 1e-4);
  }
}

TEST_CASE("fit: finds the optimum that another program found on cart-pole data") {
  const CartpoleReference ref;
  const std::vector<GpFit> fits = FitHyperparameters(ref.data, {}, {}, 1, 0, 2);
  REQUIRE(fits.size() == 4);
  for (int e = 0; e < 4; ++e) {
    CAPTURE(e);
    const std::vector<double> found = LogParameters(fits[e].hyperparameters);
    const std::vector<double> other = LogParameters(ref.hyper[e]);
    CHECK(Penalised(ref.data, e, found) >= Penalised(ref.data, e, other) - 1e-3);
    for (int p = 0; p < 8; ++p) CHECK(std::abs(found[p] - other[p]) <= 0.02);
    CHECK(fits[e].evaluations <= 200);
    CheckIsMaximum(ref.data, e, fits[e], 1e-4);
  }
}

TEST_CASE("fit: the curb holds an irrelevant input and a noise-free output") {
  const Eigen::MatrixXd x = RandomMatrix(60, 2, 5);
  const Dataset data{x, x.col(0).array().sin().matrix()};
  const GpFit fit = FitHyperparameters(data, {}, {}, 1, 0, 1).at(0);
  const double ratio = fit.hyperparameters.signal_std / fit.hyperparameters.noise_std;
  CHECK(ratio > 300);
  CHECK(ratio < 1000);
  CHECK(fit.hyperparameters.lengthscales[1] < 300);
  CheckIsMaximum(data, 0, fit, 1e-2);
}

TEST_CASE("fit: bits do not depend on the number of threads") {
  const CartpoleReference ref;
  const Dataset data{ref.data.inputs.topRows(90), ref.data.targets.topRows(90)};
  const GpFitOptions options{.restarts = 2, .max_evaluations = 40};
  const std::vector<GpFit> one = FitHyperparameters(data, ref.hyper, options, 7, 3, 1);
  for (const int threads : {2, 5}) {
    CAPTURE(threads);
    const std::vector<GpFit> many = FitHyperparameters(data, ref.hyper, options, 7, 3, threads);
    for (int e = 0; e < 4; ++e) CHECK(SameBits(one[e], many[e]));
  }
}

TEST_CASE("fit: seed, episode and output choose the starts") {
  const Eigen::MatrixXd x = RandomMatrix(30, 2, 5);
  Dataset data{x, Eigen::MatrixXd(30, 2)};
  data.targets.col(0) = data.targets.col(1) = x.col(0).array().sin() + 0.1 * x.col(1).array();
  // Of twenty starts that hardly move, each key's best is another.
  const GpFitOptions options{.restarts = 20, .max_evaluations = 1};
  const auto base = FitHyperparameters(data, {}, options, 0, 0, 1);
  CHECK(SameBits(base[0], FitHyperparameters(data, {}, options, 0, 0, 1)[0]));
  const auto differs = [&](const GpFit& fit) {
    return std::abs(fit.log_likelihood - base[0].log_likelihood) > 1e-3;
  };
  CHECK(differs(base[1]));
  CHECK(differs(FitHyperparameters(data, {}, options, 1, 0, 1)[0]));
  CHECK(differs(FitHyperparameters(data, {}, options, 0, 1, 1)[0]));
}

TEST_CASE("fit: a warm start at the optimum ends there, and soon") {
  const CartpoleReference ref;
  const GpFitOptions options{.restarts = 0};
  const auto cold = FitHyperparameters(ref.data, {}, options, 1, 0, 1);
  std::vector<Hyperparameters> optimum;
  for (const GpFit& fit : cold) optimum.push_back(fit.hyperparameters);
  const auto warm = FitHyperparameters(ref.data, optimum, options, 1, 0, 1);
  for (int e = 0; e < 4; ++e) {
    CAPTURE(e);
    CHECK(Penalised(ref.data, e, LogParameters(warm[e].hyperparameters)) >=
          Penalised(ref.data, e, LogParameters(optimum[e])) - 1e-9);
    CHECK(warm[e].evaluations < cold[e].evaluations / 2);
  }
}

TEST_CASE("fit: restarts never lower the penalised likelihood") {
  const CartpoleReference ref;
  const auto none = FitHyperparameters(ref.data, {}, {.restarts = 0}, 1, 0, 2);
  const auto some = FitHyperparameters(ref.data, {}, {.restarts = 2}, 1, 0, 2);
  for (int e = 0; e < 4; ++e) {
    CHECK(Penalised(ref.data, e, LogParameters(some[e].hyperparameters)) >=
          Penalised(ref.data, e, LogParameters(none[e].hyperparameters)));
    CHECK(some[e].evaluations > none[e].evaluations);
  }
}

TEST_CASE("fit: the best evaluation is kept however few are allowed") {
  const Eigen::MatrixXd x = RandomMatrix(40, 2, 5);
  const Dataset data{x, x.col(0).array().sin().matrix()};
  double previous = -std::numeric_limits<double>::infinity();
  for (const int evaluations : {1, 3, 10, 30}) {
    CAPTURE(evaluations);
    const GpFitOptions options{.restarts = 0, .max_evaluations = evaluations};
    const GpFit fit = FitHyperparameters(data, {}, options, 0, 0, 1).at(0);
    const double value = Penalised(data, 0, LogParameters(fit.hyperparameters));
    CHECK(value >= previous);
    previous = value;
  }
}

TEST_CASE("fit: a stop ends every start before its next likelihood") {
  const CartpoleReference ref;
  const GpFitOptions options{.restarts = 30};
  const std::atomic<bool> go = false, stop = true;
  const auto start = std::chrono::steady_clock::now();
  CHECK_NOTHROW(FitHyperparameters(ref.data, {}, options, 1, 0, 2, &go));
  const auto middle = std::chrono::steady_clock::now();
  CHECK_THROWS_AS(FitHyperparameters(ref.data, {}, options, 1, 0, 2, &stop), Interrupted);
  const auto end = std::chrono::steady_clock::now();
  // Thirty likelihoods a start, or none.
  CHECK(end - middle < (middle - start) / 3);
}

TEST_CASE("fit: degenerate data have a finite answer that predicts them") {
  const Eigen::MatrixXd x = RandomMatrix(20, 2, 3);
  const Eigen::VectorXd sine = x.col(0).array().sin();
  struct Case {
    const char* name;
    Dataset data;
  };
  std::vector<Case> cases = {
      {"constant output zero", {x, Eigen::VectorXd::Zero(20)}},
      {"constant output five", {x, Eigen::VectorXd::Constant(20, 5)}},
      {"constant inputs", {Eigen::MatrixXd::Constant(20, 2, 0.1), sine}},
      {"one point", {x.topRows(1), sine.head(1)}},
      {"one point at zero", {Eigen::MatrixXd::Zero(1, 2), Eigen::VectorXd::Zero(1)}},
      {"duplicate points", {x.replicate(3, 1), sine.replicate(3, 1)}},
      {"tiny units", {1e-9 * x, 1e-4 * sine}},
      {"huge units", {1e12 * x, 1e9 * sine}},
  };
  cases.push_back({"one constant input", {x, sine}});
  cases.back().data.inputs.col(1).setConstant(1e8);
  for (const Case& c : cases) {
    CAPTURE(c.name);
    const GpFit fit = FitHyperparameters(c.data, {}, {}, 0, 0, 1).at(0);
    CHECK(IsFinite(fit));
    const ExactGp gp(c.data.inputs, c.data.targets.col(0), fit.hyperparameters);
    for (int i = 0; i < c.data.n_points(); ++i) {
      double mean = 0, variance = 0;
      gp.Predict(c.data.inputs.row(i), &mean, &variance);
      const double std = std::sqrt(variance + std::pow(fit.hyperparameters.noise_std, 2));
      CHECK(std::abs(mean - c.data.targets(i, 0)) <= 4 * std);
    }
  }
}

TEST_CASE("fit: bad data and options are refused by name") {
  Dataset data{RandomMatrix(5, 2, 1), RandomMatrix(5, 2, 2)};
  CHECK_THROWS_AS(FitHyperparameters(Dataset{}, {}, {}, 0, 0, 1), InvalidInput);
  CHECK_THROWS_WITH_AS(FitHyperparameters(data, {}, {.restarts = 101}, 0, 0, 1),
                       "GP fit: restarts is 101, must be in [0, 100]", InvalidInput);
  CHECK_THROWS_AS(FitHyperparameters(data, {}, {.restarts = -1}, 0, 0, 1), InvalidInput);
  CHECK_THROWS_AS(FitHyperparameters(data, {}, {.max_evaluations = 0}, 0, 0, 1), InvalidInput);
  CHECK_THROWS_AS(FitHyperparameters(data, {}, {}, 0, 0, 0), InvalidInput);
  CHECK_THROWS_WITH_AS(FitHyperparameters(data, {{{1.0, 1.0}, 1.0, 0.1}}, {}, 0, 0, 1),
                       "GP fit: warm_start has 1 entries, must have 2, one an output, or none",
                       InvalidInput);
  const std::vector<Hyperparameters> bad(2, {{1.0, 1.0}, 1.0, 0.0});
  CHECK_THROWS_AS(FitHyperparameters(data, bad, {}, 0, 0, 1), InvalidInput);
  Dataset huge = data;
  huge.targets.col(1) *= 1e200;
  CHECK_THROWS_WITH_AS(
      FitHyperparameters(huge, {}, {}, 0, 0, 2),
      "GP fit: output 1 has no finite likelihood at any start; data must be of ordinary size",
      InvalidInput);
  data.targets(4, 1) = std::nan("");
  CHECK_THROWS_WITH_AS(FitHyperparameters(data, {}, {}, 0, 0, 1),
                       "GP targets: row 4, column 1 is nan, must be finite", InvalidInput);
}

}  // namespace
}  // namespace downpour
