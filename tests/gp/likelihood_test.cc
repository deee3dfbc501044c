// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/likelihood.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/gp/triangle.h"
#include "tests/gp/reference_gp.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// Lengthscales in [0.3, 3], signal in [0.5, 2], sigma_f / sigma_n in [1, 100].
Hyperparameters RandomHyperparameters(int dim, std::uint32_t stream) {
  std::vector<double> u(dim + 2);
  FillUniforms({stream, 5}, 0, u.data(), u.size());
  Hyperparameters hyper;
  for (int d = 0; d < dim; ++d) hyper.lengthscales.push_back(0.3 * std::pow(10, u[d]));
  hyper.signal_std = 0.5 * std::pow(4, u[dim]);
  hyper.noise_std = hyper.signal_std * std::pow(10, -2 * u[dim + 1]);
  return hyper;
}

struct Case {
  Eigen::MatrixXd x;
  Eigen::VectorXd y;
  Hyperparameters hyper;
};

template <typename Check>
void ForEachCase(const Check& check) {
  std::uint32_t stream = 0;
  for (const int dim : {1, 2, 3, 6, 9}) {
    for (const int n : {1, 2, 7, 33, 70}) {
      CAPTURE(dim);
      CAPTURE(n);
      ++stream;
      const Eigen::MatrixXd x = RandomMatrix(n, dim, stream);
      check(Case{x, RandomMatrix(n, 1, stream + 1000), RandomHyperparameters(dim, stream)});
    }
  }
}

// The largest s of the covariances sigma_f^2 exp(-s); rounding s gives them a relative error s eps.
double LargestExponent(const Case& c) {
  double largest = 0;
  for (Eigen::Index i = 0; i < c.x.rows(); ++i) {
    for (Eigen::Index j = 0; j < i; ++j) {
      double sum = 0;
      for (Eigen::Index d = 0; d < c.x.cols(); ++d) {
        sum += std::pow((c.x(i, d) - c.x(j, d)) / c.hyper.lengthscales[d], 2) / 2;
      }
      largest = std::max(largest, sum);
    }
  }
  return largest;
}

TEST_CASE("likelihood: value and gradient match the long-double reference") {
  ForEachCase([](const Case& c) {
    const int n = static_cast<int>(c.x.rows()), dim = static_cast<int>(c.x.cols());
    // A shift, which centring must take out again; the shifted inputs less the shift are exact.
    const Eigen::MatrixXd shifted = c.x.array() + 1024.0;
    LogLikelihood likelihood(shifted, c.y);
    std::vector<double> gradient(dim + 2);
    const double value = likelihood(LogParameters(c.hyper).data(), gradient.data());
    const ReferenceGp ref(shifted.array() - 1024.0, c.y, c.hyper);
    const double unit = kEps * (4 * ConditionBound(c.hyper, n) + LargestExponent(c));
    const double quadratic = static_cast<double>(ref.targets.dot(ref.alpha));
    CHECK(std::abs(static_cast<double>(value - ref.log_likelihood)) <= unit * (quadratic + n));
    for (int p = 0; p < dim + 2; ++p) {
      CAPTURE(p);
      long double magnitude = 0;
      const long double exact = ref.Gradient(p, &magnitude);
      CHECK(std::abs(static_cast<double>(gradient[p] - exact)) <= unit * magnitude);
    }
  });
}

TEST_CASE("likelihood: the gradient matches central differences") {
  constexpr double kStep = 1e-4;
  ForEachCase([](const Case& c) {
    const int n = static_cast<int>(c.x.rows()), dim = static_cast<int>(c.x.cols());
    LogLikelihood likelihood(c.x, c.y);
    const std::vector<double> centre = LogParameters(c.hyper);
    std::vector<double> gradient(dim + 2);
    const double value = likelihood(centre.data(), gradient.data());
    CHECK(likelihood(centre.data(), nullptr) == value);
    for (int p = 0; p < dim + 2; ++p) {
      CAPTURE(p);
      std::vector<double> moved = centre;
      moved[p] = centre[p] + kStep;
      const double above = likelihood(moved.data(), nullptr);
      moved[p] = centre[p] - kStep;
      const double below = likelihood(moved.data(), nullptr);
      // Truncation (third derivatives grow with the terms' size) and rounding of the two values.
      long double magnitude = 0;
      ReferenceGp(c.x, c.y, c.hyper).Gradient(p, &magnitude);
      const double tolerance = 10 * kStep * kStep * magnitude +
                               kEps * ConditionBound(c.hyper, n) * (std::abs(value) + n) / kStep;
      CHECK(std::abs((above - below) / (2 * kStep) - gradient[p]) <= tolerance);
    }
  });
}

TEST_CASE("likelihood: is -infinity with gradient zero where K has no Cholesky factor") {
  Eigen::MatrixXd x(3, 1);
  x << 1, 1, 2;  // a duplicate, and noise below the rounding of K
  LogLikelihood likelihood(x, Eigen::VectorXd::Ones(3));
  for (const std::vector<double>& parameters :
       {std::vector<double>{0, 0, -30}, {-800, 0, 0}, {0, 400, 0}, {std::nan(""), 0, 0}}) {
    std::vector<double> gradient(3, 5.0);
    CHECK(likelihood(parameters.data(), nullptr) == -std::numeric_limits<double>::infinity());
    CHECK(likelihood(parameters.data(), gradient.data()) ==
          -std::numeric_limits<double>::infinity());
    CHECK(gradient == std::vector<double>(3, 0.0));
  }
}

TEST_CASE("likelihood: bad data are refused by row and column") {
  Eigen::MatrixXd x = Eigen::MatrixXd::Ones(4, 2);
  CHECK_THROWS_AS(LogLikelihood(x, Eigen::VectorXd::Ones(3)), InvalidInput);
  CHECK_THROWS_AS(LogLikelihood(Eigen::MatrixXd(0, 2), Eigen::VectorXd(0)), InvalidInput);
  x(2, 1) = std::nan("");
  CHECK_THROWS_WITH_AS(LogLikelihood(x, Eigen::VectorXd::Ones(4)),
                       "GP inputs: row 2, column 1 is nan, must be finite", InvalidInput);
  x(2, 1) = 0;
  Eigen::VectorXd y = Eigen::VectorXd::Ones(4);
  y[3] = -HUGE_VAL;
  CHECK_THROWS_WITH_AS(LogLikelihood(x, y), "GP targets: row 3, column 0 is -inf, must be finite",
                       InvalidInput);
}

TEST_CASE("triangle: the inverse times the triangle is the identity, the rest is untouched") {
  for (const int n : {1, 2, 15, 16, 17, 18, 31, 33, 47, 64, 100}) {
    CAPTURE(n);
    const int ld = n + 3;
    Eigen::MatrixXd storage = RandomMatrix(ld, n, 9) / n;
    for (int i = 0; i < n; ++i) storage(i, i) = 1 + std::abs(storage(i, i));
    const Eigen::MatrixXd before = storage;
    InvertLowerTriangle(n, storage.data(), ld);
    const Eigen::MatrixXd l = before.topRows(n).triangularView<Eigen::Lower>();
    const Eigen::MatrixXd inverse = storage.topRows(n).triangularView<Eigen::Lower>();
    const Eigen::MatrixXd residual = inverse * l - Eigen::MatrixXd::Identity(n, n);
    const double scale = (inverse.cwiseAbs() * l.cwiseAbs()).maxCoeff();
    CHECK(residual.cwiseAbs().maxCoeff() <= n * kEps * scale);
    storage.topRows(n).triangularView<Eigen::Lower>() = l;
    CHECK(storage == before);
  }
}

}  // namespace
}  // namespace downpour
