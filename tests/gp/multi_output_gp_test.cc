// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/multi_output_gp.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "engine/errors.h"
#include "kernels/philox/philox.h"
#include "tests/gp/cartpole_reference.h"

namespace downpour {
namespace {

std::vector<double> Flat(const Eigen::MatrixXd& rows) {
  const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> copy = rows;
  return {copy.data(), copy.data() + copy.size()};
}

// Inputs like the data, row-major: points of pairs of them.
std::vector<double> Mixed(const Dataset& data, int n) {
  std::vector<double> u(n);
  FillUniforms({3, 4}, 0, u.data(), u.size());
  Eigen::MatrixXd rows(n, data.n_inputs());
  for (int i = 0; i < n; ++i) {
    const int a = i % data.n_points(), b = (7 * i + 3) % data.n_points();
    rows.row(i) = (1 - u[i]) * data.inputs.row(a) + u[i] * data.inputs.row(b);
  }
  return Flat(rows);
}

struct Answers {
  std::vector<double> mean, variance;
};

Answers Ask(const MultiOutputGp& gp, const std::vector<double>& inputs, bool with_noise = false,
            int threads = 1) {
  const std::size_t size = inputs.size() / gp.n_inputs() * gp.n_outputs();
  Answers answers{std::vector<double>(size), std::vector<double>(size)};
  gp.Predict(inputs, with_noise, threads, answers.mean, answers.variance);
  return answers;
}

constexpr QueryPlanOptions kExact{.variance_tolerance = 0, .mean_tolerance = 0};

TEST_CASE("multi_output_gp: exact queries are the kernel's, bit by bit, and near the reference") {
  const CartpoleReference reference;
  const MultiOutputGp gp(reference.data, reference.hyper, kExact, 1);
  const Answers answers = Ask(gp, Flat(reference.query));
  for (int e = 0; e < gp.n_outputs(); ++e) {
    const ExactGp exact(reference.data.inputs, reference.data.targets.col(e), reference.hyper[e]);
    const GpFactor factor = exact.Pack();
    AlignedVector<char> scratch(GpQueryScratchBytes(factor));
    AlignedVector<double> x(6 * kTileLanes), mean(kTileLanes), variance(kTileLanes);
    for (int i = 0; i < reference.query.rows(); ++i) {
      for (int d = 0; d < 6; ++d) x[d * kTileLanes] = reference.query(i, d);
      GpQueryTile(factor, 1, x.data(), scratch.data(), mean.data(), variance.data());
      CHECK(answers.mean[i * 4 + e] == mean[0]);
      CHECK(answers.variance[i * 4 + e] == variance[0]);
      const double predictive = reference.variance(i, e) + factor.noise_variance;
      CHECK(std::abs(mean[0] - reference.mean(i, e)) < 1e-6 * std::sqrt(predictive));
      CHECK(std::abs(variance[0] - reference.variance(i, e)) < 1e-6 * predictive);
    }
  }
}

TEST_CASE("multi_output_gp: a row's bits depend on it alone, not on threads or batch") {
  const CartpoleReference reference;
  for (const QueryPlanOptions& options : {kExact, QueryPlanOptions{}}) {
    const MultiOutputGp gp(reference.data, reference.hyper, options, 2);
    const std::vector<double> inputs = Mixed(reference.data, 1100);
    const Answers all = Ask(gp, inputs);
    for (const int threads : {2, 5}) {
      const Answers same = Ask(gp, inputs, false, threads);
      CHECK(same.mean == all.mean);
      CHECK(same.variance == all.variance);
    }
    const std::vector<double> last(inputs.end() - 6, inputs.end());
    const Answers one = Ask(gp, last);
    CHECK(std::equal(one.mean.begin(), one.mean.end(), all.mean.end() - 4));
    CHECK(std::equal(one.variance.begin(), one.variance.end(), all.variance.end() - 4));
  }
}

TEST_CASE("multi_output_gp: OpenBLAS gives the same bits for any number of threads") {
  const CartpoleReference reference;
  QueryPlanOptions options;
  options.backend = QueryBackend::kBlas;
  const MultiOutputGp gp(reference.data, reference.hyper, options, 2);
  const MultiOutputGp exact(reference.data, reference.hyper, kExact, 1);
  const std::vector<double> inputs = Mixed(reference.data, 1100);
  const Answers one = Ask(gp, inputs), three = Ask(gp, inputs, false, 3),
                fused = Ask(exact, inputs);
  CHECK(one.mean == three.mean);
  CHECK(one.variance == three.variance);
  for (std::size_t i = 0; i < one.mean.size(); ++i) {
    const double noise = reference.hyper[i % 4].noise_std;
    const double predictive = fused.variance[i] + noise * noise;
    CHECK(std::abs(one.variance[i] - fused.variance[i]) < 1e-6 * predictive);
    CHECK(std::abs(one.mean[i] - fused.mean[i]) < 1e-6 * std::sqrt(predictive));
  }
}

TEST_CASE("multi_output_gp: plans keep the tolerances on inputs that they have not seen") {
  const CartpoleReference reference;
  const QueryPlanOptions options;
  const MultiOutputGp gp(reference.data, reference.hyper, options, 2);
  const MultiOutputGp exact(reference.data, reference.hyper, kExact, 1);
  const std::vector<double> inputs = Mixed(reference.data, 2000);
  const Answers planned = Ask(gp, inputs, true), wanted = Ask(exact, inputs, true);
  int compressed = 0;
  for (const OutputPlan& plan : gp.plans()) compressed += plan.compressed ? 1 : 0;
  CHECK(compressed > 0);
  for (std::size_t i = 0; i < planned.mean.size(); ++i) {
    const double variance = wanted.variance[i];
    CHECK(std::abs(planned.variance[i] - variance) <= options.variance_tolerance * variance);
    CHECK(std::abs(planned.mean[i] - wanted.mean[i]) <=
          options.mean_tolerance * std::sqrt(variance));
  }
}

TEST_CASE("multi_output_gp: noise is added where it is asked for, and means alone are the same") {
  const CartpoleReference reference;
  const MultiOutputGp gp(reference.data, reference.hyper, {}, 1);
  const std::vector<double> inputs = Flat(reference.query);
  const Answers latent = Ask(gp, inputs), noisy = Ask(gp, inputs, true);
  std::vector<double> means(latent.mean.size());
  gp.Predict(inputs, true, 1, means, {});
  CHECK(means == latent.mean);
  CHECK(noisy.mean == latent.mean);
  for (std::size_t i = 0; i < means.size(); ++i) {
    const double noise = reference.hyper[i % 4].noise_std;
    CHECK(noisy.variance[i] == latent.variance[i] + noise * noise);
  }
}

TEST_CASE("multi_output_gp: sizes that disagree are refused, a batch may be empty") {
  const CartpoleReference reference;
  CHECK_THROWS_AS(MultiOutputGp(reference.data, {}, {}, 1), InvalidInput);
  const MultiOutputGp gp(reference.data, reference.hyper, {}, 1);
  std::vector<double> inputs(12), out(8), wrong(7);
  CHECK_THROWS_AS(gp.Predict(std::span(inputs).first(11), false, 1, out, out), InvalidInput);
  CHECK_THROWS_AS(gp.Predict(inputs, false, 1, wrong, {}), InvalidInput);
  CHECK_THROWS_AS(gp.Predict(inputs, false, 1, out, wrong), InvalidInput);
  CHECK_NOTHROW(gp.Predict({}, false, 1, {}, {}));
}

TEST_CASE("multi_output_gp: a fit is that of FitHyperparameters") {
  const CartpoleReference reference;
  Dataset data{reference.data.inputs.topRows(40), reference.data.targets.topRows(40)};
  const MultiOutputGp gp = MultiOutputGp::Fit(data, {}, 5, 2);
  const std::vector<GpFit> fits = FitHyperparameters(data, {}, {}, 5, 0, 1);
  for (int e = 0; e < gp.n_outputs(); ++e) {
    CHECK(gp.exact()[e].hyperparameters().lengthscales == fits[e].hyperparameters.lengthscales);
    CHECK(gp.exact()[e].hyperparameters().noise_std == fits[e].hyperparameters.noise_std);
  }
}

}  // namespace
}  // namespace downpour
