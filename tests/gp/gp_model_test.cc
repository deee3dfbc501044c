// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/gp_model.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "engine/errors.h"
#include "engine/gp/likelihood.h"
#include "kernels/aligned.h"
#include "tests/gp/cartpole_reference.h"
#include "tests/gp/reference_gp.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// |k|^T |alpha|, what rounding in the mean scales with.
double MeanMagnitude(const ExactGp& gp, const Eigen::VectorXd& input) {
  const Hyperparameters& h = gp.hyperparameters();
  double sum = 0;
  for (Eigen::Index i = 0; i < gp.inputs().rows(); ++i) {
    double distance = 0;
    for (Eigen::Index d = 0; d < input.size(); ++d) {
      distance += std::pow((gp.inputs()(i, d) - input[d]) / h.lengthscales[d], 2);
    }
    sum += h.signal_std * h.signal_std * std::exp(-0.5 * distance) * std::abs(gp.alpha()[i]);
  }
  return sum;
}

TEST_CASE("gp_model: predictions on cart-pole data match the 80-bit reference") {
  const CartpoleReference ref;
  for (int e = 0; e < 4; ++e) {
    CAPTURE(e);
    const ExactGp gp(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    CHECK(gp.jitter() == 0);
    // alpha and L^-1 k carry a relative error of eps times the condition number.
    const double unit = kEps * ConditionBound(ref.hyper[e], 160);
    const double signal_variance = ref.hyper[e].signal_std * ref.hyper[e].signal_std;
    for (int q = 0; q < 50; ++q) {
      CAPTURE(q);
      double mean = 0, variance = 0;
      gp.Predict(ref.query.row(q), &mean, &variance);
      CHECK(std::abs(mean - ref.mean(q, e)) <= unit * MeanMagnitude(gp, ref.query.row(q)));
      CHECK(std::abs(variance - ref.variance(q, e)) <= unit * signal_variance);
    }
  }
}

TEST_CASE("gp_model: the packed factor answers as Predict does") {
  const CartpoleReference ref;
  for (int e = 0; e < 4; ++e) {
    CAPTURE(e);
    const ExactGp gp(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const GpFactor factor = gp.Pack();
    CHECK(factor.noise_variance == doctest::Approx(std::pow(ref.hyper[e].noise_std, 2)));
    AlignedVector<double> x(6 * kTileLanes);
    AlignedVector<unsigned char> scratch(GpQueryScratchBytes(factor));
    AlignedVector<double> mean(kTileLanes), variance(kTileLanes);
    for (int d = 0; d < 6; ++d) {
      for (int lane = 0; lane < kTileLanes; ++lane) x[d * kTileLanes + lane] = ref.query(lane, d);
    }
    GpQueryTile(factor, kTileLanes, x.data(), scratch.data(), mean.data(), variance.data());
    const double unit = kEps * ConditionBound(ref.hyper[e], 160);
    for (int lane = 0; lane < kTileLanes; ++lane) {
      double exact_mean = 0, exact_variance = 0;
      gp.Predict(ref.query.row(lane), &exact_mean, &exact_variance);
      CHECK(std::abs(mean[lane] - exact_mean) <= unit * MeanMagnitude(gp, ref.query.row(lane)));
      CHECK(std::abs(variance[lane] - exact_variance) <=
            unit * std::pow(ref.hyper[e].signal_std, 2));
    }
  }
}

TEST_CASE("gp_model: L L^T is K, L has zeros above, and the likelihood is that of LogLikelihood") {
  for (const int n : {1, 2, 7, 33, 100}) {
    CAPTURE(n);
    const Eigen::MatrixXd x = RandomMatrix(n, 3, n);
    const Eigen::VectorXd y = RandomMatrix(n, 1, n + 500);
    const Hyperparameters hyper{{0.7, 1.1, 2.0}, 1.5, 0.2};
    const ExactGp gp(x, y, hyper);
    const ReferenceGp ref(x, y, hyper);
    const Eigen::MatrixXd k = gp.cholesky() * gp.cholesky().transpose();
    Eigen::MatrixXd exact = ref.noise_free.cast<double>();
    exact.diagonal().array() += 0.2 * 0.2;
    CHECK((k - exact).cwiseAbs().maxCoeff() <= 2 * (n + 20) * kEps * 1.5 * 1.5);
    for (int j = 1; j < n; ++j) CHECK(gp.cholesky().col(j).head(j).isZero(0));
    const double unit = kEps * ConditionBound(hyper, n);
    const double value = LogLikelihood(x, y)(LogParameters(hyper).data(), nullptr);
    CHECK(std::abs(gp.log_marginal_likelihood() - value) <= unit * (std::abs(value) + n));
    CHECK((gp.alpha() - ref.alpha.cast<double>()).norm() <= unit * gp.alpha().norm());
  }
}

TEST_CASE("gp_model: one point has the closed form") {
  const Hyperparameters hyper{{2.0}, 3.0, 0.5};
  const ExactGp gp(Eigen::MatrixXd::Constant(1, 1, 1.0), Eigen::VectorXd::Constant(1, 4.0), hyper);
  double mean = 0, variance = 0;
  gp.Predict(Eigen::VectorXd::Constant(1, 2.0), &mean, &variance);
  const double k = 9 * std::exp(-0.125);
  CHECK(mean == doctest::Approx(k * 4 / 9.25).epsilon(16 * kEps));
  CHECK(variance == doctest::Approx(9 - k * k / 9.25).epsilon(16 * kEps));
  // Far from the data the prior comes back.
  gp.Predict(Eigen::VectorXd::Constant(1, 1e6), &mean, &variance);
  CHECK(mean == 0);
  CHECK(variance == 9);
}

TEST_CASE("gp_model: duplicate points without noise take jitter and are interpolated") {
  Eigen::MatrixXd x(4, 1);
  x << 0, 1, 1, 3;
  Eigen::VectorXd y(4);
  y << 1, 2, 2, -1;
  const ExactGp gp(x, y, {{1.0}, 2.0, 1e-12});
  CHECK(gp.jitter() == 1e-10 * 4);
  for (int i = 0; i < 4; ++i) {
    double mean = 0, variance = 0;
    gp.Predict(x.row(i), &mean, &variance);
    // The jitter acts as noise: y - mean = jitter * alpha.
    CHECK(std::abs(mean - y[i]) <= 1e-8);
    CHECK(variance >= 0);
    CHECK(variance <= 1e-8);
  }
  const GpFactor factor = gp.Pack();
  for (const double w : factor.triangle) CHECK(std::isfinite(w));
}

TEST_CASE("gp_model: many duplicate points raise the jitter until K factors") {
  const Eigen::MatrixXd x = RandomMatrix(300, 1, 1) * 1e-3;  // all within one lengthscale
  const Eigen::VectorXd y = Eigen::VectorXd::Ones(300);
  const ExactGp gp(x, y, {{1e3}, 1.0, 1e-100});
  CHECK(gp.jitter() >= 1e-10);
  CHECK(gp.jitter() <= 1e-9);
  double mean = 0, variance = 0;
  gp.Predict(Eigen::VectorXd::Zero(1), &mean, &variance);
  CHECK(mean == doctest::Approx(1).epsilon(1e-6));
  CHECK(variance <= 1e-9);
}

TEST_CASE("gp_model: duplicate points with noise count twice") {
  // Two equal measurements are one of half the noise variance.
  const Eigen::MatrixXd two = Eigen::MatrixXd::Constant(2, 1, 0.3);
  const Eigen::MatrixXd one = Eigen::MatrixXd::Constant(1, 1, 0.3);
  const ExactGp twice(two, Eigen::VectorXd::Constant(2, 1.5), {{1.0}, 1.0, 0.2});
  const ExactGp once(one, Eigen::VectorXd::Constant(1, 1.5), {{1.0}, 1.0, 0.2 / std::sqrt(2.0)});
  double mean2 = 0, variance2 = 0, mean1 = 0, variance1 = 0;
  twice.Predict(Eigen::VectorXd::Zero(1), &mean2, &variance2);
  once.Predict(Eigen::VectorXd::Zero(1), &mean1, &variance1);
  CHECK(mean2 == doctest::Approx(mean1).epsilon(100 * kEps));
  CHECK(variance2 == doctest::Approx(variance1).epsilon(100 * kEps));
}

TEST_CASE("gp_model: points appended give the model of all points") {
  const Hyperparameters hyper{{0.7, 1.1, 2.0}, 1.5, 0.2};
  for (const int n : {1, 7, 60}) {
    for (const int k : {1, 2, 40}) {
      CAPTURE(n);
      CAPTURE(k);
      Eigen::MatrixXd x = RandomMatrix(n + k, 3, n);
      x.row(n) = x.row(0);  // a duplicate, which the noise makes harmless
      const Eigen::VectorXd y = RandomMatrix(n + k, 1, n + 500);
      const ExactGp all(x, y, hyper);
      const ExactGp before(x.topRows(n), y.head(n), hyper);
      const ExactGp gp = before.Append(x.bottomRows(k), y.tail(k));
      const double unit = 4 * kEps * ConditionBound(hyper, n + k);
      const double value = all.log_marginal_likelihood();
      CHECK(gp.inputs() == x);
      CHECK(gp.jitter() == 0);
      CHECK((gp.cholesky() - all.cholesky()).norm() <= unit * all.cholesky().norm());
      CHECK((gp.alpha() - all.alpha()).norm() <= unit * all.alpha().norm());
      CHECK(std::abs(gp.log_marginal_likelihood() - value) <= unit * (std::abs(value) + n + k));
      for (int j = 1; j < n + k; ++j) CHECK(gp.cholesky().col(j).head(j).isZero(0));
    }
  }
}

TEST_CASE("gp_model: appended points that need jitter give the model of all points, bit by bit") {
  Eigen::MatrixXd x(4, 1);
  x << 1, 3, 1, 5;
  const Eigen::VectorXd y = RandomMatrix(4, 1, 1);
  const Hyperparameters hyper{{1.0}, 2.0, 1e-12};
  const ExactGp before(x.topRows(2), y.head(2), hyper), all(x, y, hyper);
  REQUIRE(before.jitter() == 0);
  REQUIRE(all.jitter() > 0);
  const ExactGp three = before.Append(x.middleRows(2, 1), y.segment(2, 1));
  CHECK(three.jitter() > 0);
  // The second time the model appended to has the jitter.
  for (const ExactGp& gp :
       {before.Append(x.bottomRows(2), y.tail(2)), three.Append(x.bottomRows(1), y.tail(1))}) {
    CHECK(gp.jitter() == all.jitter());
    CHECK(gp.cholesky() == all.cholesky());
    CHECK(gp.alpha() == all.alpha());
    CHECK(gp.log_marginal_likelihood() == all.log_marginal_likelihood());
  }
}

TEST_CASE("gp_model: bad hyper-parameters, data and queries are refused by name") {
  const Eigen::MatrixXd x = RandomMatrix(3, 2, 1);
  const Eigen::VectorXd y = Eigen::VectorXd::Ones(3);
  CHECK_THROWS_WITH_AS(ExactGp(x, y, {{1.0}, 1.0, 0.1}),
                       "GP hyper-parameters: 1 lengthscales, must be 2, one an input",
                       InvalidInput);
  CHECK_THROWS_WITH_AS(ExactGp(x, y, {{1.0, -2.0}, 1.0, 0.1}),
                       "GP hyper-parameters: lengthscale 1 is -2, must be in [1e-150, 1e150]",
                       InvalidInput);
  CHECK_THROWS_AS(ExactGp(x, y, {{1.0, 1.0}, 0.0, 0.1}), InvalidInput);
  CHECK_THROWS_AS(ExactGp(x, y, {{1.0, 1.0}, 1.0, std::nan("")}), InvalidInput);
  CHECK_THROWS_AS(ExactGp(x, y, {{1.0, 1.0}, HUGE_VAL, 0.1}), InvalidInput);
  CHECK_THROWS_AS(ExactGp(x * 1e200, y, {{1e-150, 1.0}, 1.0, 0.1}), InvalidInput);
  CHECK_THROWS_AS(ExactGp(x, Eigen::VectorXd::Ones(2), {{1.0, 1.0}, 1.0, 0.1}), InvalidInput);
  Eigen::MatrixXd bad = x;
  bad(1, 0) = HUGE_VAL;
  CHECK_THROWS_WITH_AS(ExactGp(bad, y, {{1.0, 1.0}, 1.0, 0.1}),
                       "GP inputs: row 1, column 0 is inf, must be finite", InvalidInput);
  const ExactGp gp(x, y, {{1.0, 1.0}, 1.0, 0.1});
  CHECK_THROWS_WITH_AS(gp.Append(Eigen::MatrixXd::Ones(3, 1), y),
                       "GP append: points have 1 inputs, must have 2", InvalidInput);
  CHECK_THROWS_AS(gp.Append(bad, y), InvalidInput);
  double mean = 0, variance = 0;
  CHECK_THROWS_AS(gp.Predict(Eigen::VectorXd::Zero(3), &mean, &variance), InvalidInput);
}

}  // namespace
}  // namespace downpour
