// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/compression.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "tests/gp/cartpole_reference.h"
#include "tests/gp/reference_gp.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// The reduced posterior of given points by its definition, in long double: the exact posterior
// N(m_u, S_uu) at the points, carried elsewhere by the noise-free prior.
struct ReferenceReduction {
  const ReferenceGp& gp;
  std::vector<int> points;
  LongMatrix between;               // K_un
  Eigen::LLT<LongMatrix> k_uu;      // noise-free
  LongMatrix covariance_at_points;  // S_uu = K_uu - K_un K^-1 K_nu
  LongVector mean_at_points;
  LongMatrix residual;  // K_nn - K_nu K_uu^-1 K_un

  ReferenceReduction(const ReferenceGp& reference, const std::vector<int>& picked)
      : gp(reference), points(picked) {
    between = gp.noise_free(points, Eigen::all);
    const LongMatrix k = gp.noise_free(points, points);
    k_uu.compute(k);
    covariance_at_points = k - between * gp.inverse * between.transpose();
    mean_at_points = between * gp.alpha;
    residual = gp.noise_free - between.transpose() * k_uu.solve(between);
  }

  LongVector Covariances(const Eigen::VectorXd& x) const {
    LongVector k(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) k[i] = gp.Kernel(gp.inputs.row(points[i]), x);
    return k;
  }

  void Predict(const Eigen::VectorXd& x, long double* mean, long double* variance,
               long double* prior_residual) const {
    const LongVector k = Covariances(x);
    const LongVector c = k_uu.solve(k);
    *mean = c.dot(mean_at_points);
    *prior_residual = gp.Kernel(x, x) - k.dot(c);
    *variance = *prior_residual + c.dot(covariance_at_points * c);
  }
};

void ExactPredict(const ReferenceGp& gp, const Eigen::VectorXd& x, long double* mean,
                  long double* variance) {
  LongVector k(gp.inputs.rows());
  for (Eigen::Index i = 0; i < k.size(); ++i) k[i] = gp.Kernel(gp.inputs.row(i), x);
  *mean = k.dot(gp.alpha);
  *variance = gp.Kernel(x, x) - k.dot(gp.inverse * k);
}

// mean and variance of a reduced posterior, its fp64 numbers used in long double.
void Apply(const ReducedPosterior& posterior, const LongVector& k, double signal_variance,
           long double* mean, long double* variance) {
  *mean = posterior.weights.cast<long double>().dot(k);
  *variance = signal_variance - (posterior.root.cast<long double>() * k).squaredNorm();
}

TEST_CASE("compression: weights and root reproduce the posterior carried by the points") {
  const CartpoleReference ref;
  for (int e = 0; e < 4; ++e) {
    const ExactGp exact(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const ReferenceGp gp(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const Compression compression(exact, 1e-4);
    const double signal_variance = std::pow(ref.hyper[e].signal_std, 2);
    for (const double tau : {1.0, 0.01, 1e-4}) {
      CAPTURE(e);
      CAPTURE(tau);
      const ReducedPosterior posterior = compression.First(compression.PointsFor(tau));
      const ReferenceReduction reduction(gp, posterior.points);
      const double m = static_cast<double>(posterior.points.size());
      REQUIRE(posterior.root.isLowerTriangular(0));
      // W, hence G, carries eps times the condition number of L, up to rounding's sqrt(n).
      const double unit = 160 * kEps * std::sqrt(ConditionBound(ref.hyper[e], 160) * m / tau);
      for (int q = 0; q < 50; ++q) {
        const LongVector k = reduction.Covariances(ref.query.row(q));
        long double mean = 0, variance = 0, reference_mean = 0, reference_variance = 0, r = 0;
        Apply(posterior, k, signal_variance, &mean, &variance);
        reduction.Predict(ref.query.row(q), &reference_mean, &reference_variance, &r);
        const long double size = k.cwiseAbs().dot(posterior.weights.cwiseAbs().cast<long double>());
        CHECK(std::abs(mean - reference_mean) <= unit * size);
        CHECK(std::abs(variance - reference_variance) <= unit * signal_variance);
      }
    }
  }
}

TEST_CASE("compression: the error against the exact posterior obeys the stated bound") {
  const CartpoleReference ref;
  for (int e = 0; e < 4; ++e) {
    const ExactGp exact(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const ReferenceGp gp(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const Compression compression(exact, 1e-4);
    const long double s = std::pow(ref.hyper[e].noise_std, 2);
    const long double rounding = 160 * 160 * std::numeric_limits<long double>::epsilon() *
                                 std::pow(ref.hyper[e].signal_std, 2);
    for (const double tau : {1.0, 0.1, 0.01, 0.001}) {
      CAPTURE(e);
      CAPTURE(tau);
      const int m = compression.PointsFor(tau);
      const ReferenceReduction reduction(gp, compression.First(m).points);
      CHECK(reduction.residual.diagonal().maxCoeff() <= tau * s);
      // One point fewer is too few.
      std::vector<int> fewer = reduction.points;
      fewer.pop_back();
      CHECK(ReferenceReduction(gp, fewer).residual.diagonal().maxCoeff() >= tau * s);
      const long double energy = gp.alpha.dot(reduction.residual * gp.alpha);
      for (int q = 0; q < 50; ++q) {
        long double mean = 0, variance = 0, exact_mean = 0, exact_variance = 0, r = 0;
        reduction.Predict(ref.query.row(q), &mean, &variance, &r);
        ExactPredict(gp, ref.query.row(q), &exact_mean, &exact_variance);
        // Queries at a picked point leave rounding of the reference itself.
        r = std::max(r, 0.0L) + rounding;
        CHECK(std::abs(mean - exact_mean) <= std::sqrt(r * energy));
        CHECK(std::abs(variance - exact_variance) <= r + 2 * std::sqrt(r * variance));
      }
    }
  }
}

// Worst variance error / (variance + noise variance) and mean error / its square root.
std::pair<double, double> WorstErrors(const ExactGp& exact, const ReferenceGp& gp,
                                      const ReducedPosterior& posterior,
                                      const Eigen::MatrixXd& queries) {
  const ReferenceReduction reduction(gp, posterior.points);
  const Hyperparameters& h = exact.hyperparameters();
  std::pair<double, double> worst(0, 0);
  for (Eigen::Index q = 0; q < queries.rows(); ++q) {
    long double mean = 0, variance = 0, exact_mean = 0, exact_variance = 0;
    Apply(posterior, reduction.Covariances(queries.row(q)), h.signal_std * h.signal_std, &mean,
          &variance);
    ExactPredict(gp, queries.row(q), &exact_mean, &exact_variance);
    const long double predictive = exact_variance + h.noise_std * h.noise_std;
    worst.first = std::max<double>(worst.first, std::abs(variance - exact_variance) / predictive);
    worst.second =
        std::max<double>(worst.second, std::abs(mean - exact_mean) / std::sqrt(predictive));
  }
  return worst;
}

TEST_CASE("compression: the error falls with tau") {
  const CartpoleReference ref;
  for (int e = 0; e < 4; ++e) {
    CAPTURE(e);
    const ExactGp exact(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const ReferenceGp gp(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const Compression compression(exact, 1e-6);
    double last = HUGE_VAL;
    for (const double tau : {1.0, 0.01, 1e-4, 1e-6}) {
      CAPTURE(tau);
      const auto [variance, mean] =
          WorstErrors(exact, gp, compression.First(compression.PointsFor(tau)), ref.query);
      CHECK(variance < last);
      last = variance / 2;
    }
    CHECK(last <= 1e-4);
  }
}

TEST_CASE("compression: all points are the exact posterior") {
  // Points far apart are all picked; the residual is zero then.
  for (const int n : {1, 2, 7, 8, 9, 40}) {
    CAPTURE(n);
    const Eigen::MatrixXd x = RandomMatrix(n, 3, n);
    const Eigen::VectorXd y = RandomMatrix(n, 1, n + 500);
    const Hyperparameters hyper{{0.3, 0.4, 0.5}, 1.5, 0.2};
    const ExactGp exact(x, y, hyper);
    const Compression compression(exact, 1e-9);
    REQUIRE(compression.size() == n);
    const auto [variance, mean] = WorstErrors(exact, ReferenceGp(x, y, hyper), compression.First(n),
                                              RandomMatrix(30, 3, 900));
    const double unit = 64 * n * kEps * ConditionBound(hyper, n);
    CHECK(variance <= unit);
    CHECK(mean <= unit * y.norm() / hyper.noise_std);
  }
}

// Root mean square error of a factor's variances at the queries, in noise variances.
double VarianceError(const GpFactor32& factor, const GpFactor& expected,
                     const Eigen::MatrixXd& queries) {
  AlignedVector<double> x(queries.cols() * kTileLanes), mean(kTileLanes), a(kTileLanes),
      b(kTileLanes);
  AlignedVector<char> scratch(GpQueryScratchBytes(expected));
  double sum = 0;
  for (Eigen::Index q = 0; q < queries.rows(); ++q) {
    for (Eigen::Index d = 0; d < queries.cols(); ++d) x[d * kTileLanes] = queries(q, d);
    GpQueryTile(factor, 1, x.data(), scratch.data(), mean.data(), a.data());
    GpQueryTile(expected, 1, x.data(), scratch.data(), mean.data(), b.data());
    sum += std::pow((a[0] - b[0]) / expected.noise_variance, 2);
  }
  return std::sqrt(sum / static_cast<double>(queries.rows()));
}

TEST_CASE("compression: deflation takes most of its error from single precision") {
  const CartpoleReference ref;
  double plain_error = 0, deflated_error = 0;
  for (int e = 0; e < 4; ++e) {
    CAPTURE(e);
    const ExactGp exact(ref.data.inputs, ref.data.targets.col(e), ref.hyper[e]);
    const Compression compression(exact, 1e-3);
    ReducedPosterior posterior = compression.First(compression.size());
    const GpFactor expected = PackPosterior<double>(exact, posterior);
    const GpFactor32 deflated = PackPosterior<float>(exact, posterior);
    REQUIRE(deflated.deflation.size() == deflated.n_padded * std::size_t{kRowBlock});
    posterior.deflation.resize(0, 0);
    const GpFactor32 plain = PackPosterior<float>(exact, posterior);
    REQUIRE(plain.deflation.empty());
    plain_error += VarianceError(plain, expected, ref.query);
    deflated_error += VarianceError(deflated, expected, ref.query);
  }
  CHECK(deflated_error < plain_error / 2);
  CHECK(deflated_error > 0);
}

TEST_CASE("compression: duplicates are picked once and count twice") {
  const Eigen::MatrixXd once = RandomMatrix(20, 2, 3);
  Eigen::MatrixXd twice(40, 2);
  twice << once, once;
  const Eigen::VectorXd y = RandomMatrix(40, 1, 4);
  const Hyperparameters hyper{{0.5, 0.5}, 1.0, 0.1};
  const ExactGp exact(twice, y, hyper);
  // Below rounding: what is left of a duplicate must not be taken for a new point.
  const Compression compression(exact, 1e-15);
  CHECK(compression.size() == 20);
  const ReducedPosterior posterior = compression.First(20);
  const auto [variance, mean] =
      WorstErrors(exact, ReferenceGp(twice, y, hyper), posterior, RandomMatrix(30, 2, 5));
  const double unit = 64 * 40 * kEps * ConditionBound(hyper, 40);
  CHECK(variance <= unit);
  CHECK(mean <= unit * y.norm() / hyper.noise_std);
}

TEST_CASE("compression: equal points, noise above the signal and jitter need few points") {
  const Eigen::MatrixXd equal = Eigen::MatrixXd::Constant(30, 2, 0.7);
  const Eigen::VectorXd y = Eigen::VectorXd::Constant(30, 1.5);
  CHECK(Compression(ExactGp(equal, y, {{1.0, 1.0}, 1.0, 0.1}), 1e-6).size() == 1);
  const Eigen::MatrixXd x = RandomMatrix(30, 2, 6);
  CHECK(Compression(ExactGp(x, y, {{1.0, 1.0}, 1e-3, 1.0}), 0.01).size() == 1);
  // Jitter stands for noise: what it hides is not picked.
  const ExactGp jittered(RandomMatrix(300, 1, 1) * 1e-3, Eigen::VectorXd::Ones(300),
                         {{1e3}, 1.0, 1e-100});
  REQUIRE(jittered.jitter() > 0);
  const Compression compression(jittered, 1);
  CHECK(compression.size() == 1);
  const ReducedPosterior posterior = compression.First(compression.size());
  CHECK(posterior.root.allFinite());
  CHECK(posterior.weights.allFinite());
}

TEST_CASE("compression: the exact posterior as a reduced one packs to ExactGp::Pack") {
  const Eigen::MatrixXd x = RandomMatrix(21, 3, 8);
  const ExactGp exact(x, RandomMatrix(21, 1, 9), {{0.7, 1.0, 2.0}, 1.5, 0.2});
  const GpFactor expected = exact.Pack();
  const GpFactor factor = PackPosterior<double>(exact, ExactPosterior(exact));
  CHECK(factor.n == 21);
  CHECK(factor.inputs == expected.inputs);
  CHECK(factor.weights == expected.weights);
  CHECK(factor.triangle == expected.triangle);
}

}  // namespace
}  // namespace downpour
