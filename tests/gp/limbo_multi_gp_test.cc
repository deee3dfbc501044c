// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/limbo_multi_gp.h"

#include <doctest/doctest.h>

#include <Eigen/LU>
#include <cmath>
#include <vector>

#include "engine/errors.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

struct Samples {
  explicit Samples(int n) {
    std::vector<double> u(static_cast<std::size_t>(n) * 3);
    FillUniforms({8, 9}, 0, u.data(), u.size());
    for (int i = 0; i < n; ++i) {
      inputs.push_back(Eigen::Vector3d(u[3 * i], u[3 * i + 1], u[3 * i + 2]));
      outputs.push_back(Eigen::Vector2d(std::sin(3 * u[3 * i]), u[3 * i + 1] * u[3 * i + 2]));
    }
  }
  std::vector<Eigen::VectorXd> inputs, outputs;
};

// The posterior by its definition, with limbo's default hyper-parameters: l = sigma_f = 1 and
// noise 0.01.
void Reference(const Samples& s, const Eigen::VectorXd& v, Eigen::VectorXd* mu, double* sigma) {
  const auto n = static_cast<Eigen::Index>(s.inputs.size());
  using Matrix = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;
  Matrix covariance(n, n), observations(n, 2), k(n, 1);
  const auto kernel = [](const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
    return std::exp(-0.5L * (a - b).cast<long double>().squaredNorm());
  };
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) covariance(i, j) = kernel(s.inputs[i], s.inputs[j]);
    covariance(i, i) += 0.01L;
    k(i) = kernel(s.inputs[i], v);
    observations.row(i) = s.outputs[i].cast<long double>();
  }
  const Matrix solved = covariance.partialPivLu().solve(k);
  *mu = (observations.transpose() * solved).cast<double>();
  *sigma = static_cast<double>(1.01L - (k.transpose() * solved)(0));
}

TEST_CASE("limbo_multi_gp: query, mu and sigma are the posterior with limbo's defaults") {
  const Samples samples(25);
  LimboMultiGp gp;
  gp.compute(samples.inputs, samples.outputs);
  CHECK(gp.dim_in() == 3);
  CHECK(gp.dim_out() == 2);
  CHECK(gp.nb_samples() == 25);
  const Eigen::VectorXd v = Eigen::Vector3d(0.3, 0.6, 0.2);
  Eigen::VectorXd mu;
  double sigma = 0;
  Reference(samples, v, &mu, &sigma);
  // Condition number of K at most (25 + 0.01) / 0.01; |k| <= 5, |y| <= 5.
  const double tolerance = 25 * 25 * 2501 * 2.2e-16;
  const auto [mu_of, sigma_of] = gp.query(v);
  CHECK((mu_of - mu).cwiseAbs().maxCoeff() <= tolerance);
  CHECK(std::abs(sigma_of(0) - sigma) <= tolerance);
  CHECK(sigma_of(0) == sigma_of(1));
  CHECK(gp.mu(v) == mu_of);
  CHECK(gp.sigma(v) == sigma_of);
}

TEST_CASE("limbo_multi_gp: a batch has the bits of single queries") {
  const Samples samples(40);
  LimboMultiGp gp(3, 2, {.threads = 2});
  gp.compute(samples.inputs, samples.outputs, false);
  gp.optimize_hyperparams();
  const Eigen::MatrixXd v = Eigen::MatrixXd::Random(101, 3);
  const auto [means, variances] = gp.query_batch(v);
  for (int i = 0; i < 101; ++i) {
    const auto [mu, sigma] = gp.query(v.row(i));
    CHECK(mu.transpose() == means.row(i));
    CHECK(sigma.transpose() == variances.row(i));
  }
}

TEST_CASE("limbo_multi_gp: add_sample is compute of all samples, and hyper-parameters are kept") {
  const Samples samples(12);
  LimboMultiGp all, added(3, 2);
  std::vector<Hyperparameters> hyperparameters(2, {{0.5, 0.7, 0.9}, 1.5, 0.2});
  added.set_hyperparameters(hyperparameters);
  for (int i = 0; i < 12; ++i) added.add_sample(samples.inputs[i], samples.outputs[i]);
  all.compute(samples.inputs, samples.outputs, false);
  all.set_hyperparameters(hyperparameters);
  all.compute(samples.inputs, samples.outputs);
  const Eigen::VectorXd v = Eigen::Vector3d(0.1, 0.2, 0.3);
  CHECK(added.mu(v) == all.mu(v));
  CHECK(added.sigma(v) == all.sigma(v));
  CHECK(added.observations_matrix().row(3) == samples.outputs[3].transpose());
  CHECK(added.mean_observation() == Eigen::VectorXd(all.observations_matrix().colwise().mean()));
  all.optimize_hyperparams();
  const double learnt = all.hyperparameters()[0].signal_std;
  CHECK(learnt != 1.5);
  all.compute(samples.inputs, samples.outputs);
  CHECK(all.hyperparameters()[0].signal_std == learnt);
}

TEST_CASE("limbo_multi_gp: before there is data it is the prior, and bad calls are refused") {
  const Eigen::VectorXd v = Eigen::Vector3d(1, 2, 3), two = Eigen::Vector2d(1, 2);
  LimboMultiGp gp(3, 2);
  CHECK(gp.mu(v) == Eigen::Vector2d::Zero());
  CHECK(gp.sigma(v)(1) == 1 + 0.1 * 0.1);
  CHECK(gp.nb_samples() == 0);
  CHECK(gp.mean_observation() == Eigen::Vector2d::Zero());
  CHECK_THROWS_AS(gp.mu(two), InvalidInput);
  CHECK_THROWS_AS(gp.compute({}, {}), InvalidInput);
  CHECK_THROWS_AS(gp.compute({v, two}, {two, two}), InvalidInput);
  CHECK_THROWS_AS(gp.compute({v}, {two, two}), InvalidInput);
  CHECK_THROWS_AS(gp.add_sample(two, two), InvalidInput);
  CHECK_THROWS_AS(gp.optimize_hyperparams(), InvalidInput);
  CHECK_THROWS_AS(gp.set_hyperparameters({}), InvalidInput);
  CHECK_THROWS_AS(LimboMultiGp().mu(v), InvalidInput);
  CHECK_THROWS_AS(LimboMultiGp(0, 1), InvalidInput);
  gp.compute({v}, {two}, false);
  CHECK_THROWS_WITH_AS(gp.mu(v), "GP: no model: optimize_hyperparams or recompute must come first",
                       InvalidInput);
}

}  // namespace
}  // namespace downpour
