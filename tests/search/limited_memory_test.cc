// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "engine/errors.h"
#include "engine/search/cma_es.h"
#include "tests/search/test_functions.h"

namespace downpour {
namespace {

using Vector = std::vector<long double>;

long double Dot(const Vector& a, const Vector& b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0L);
}

// Algorithm 1 of arXiv 1705.06693, candidate by candidate.
struct Reference {
  Reference(int dimension, int population, double mean, double step)
      : n(dimension),
        lambda(population),
        m(4 + static_cast<int>(3 * std::log(dimension))),
        y(n, mean),
        p(n),
        M(m, Vector(n)),
        sigma(step) {
    for (int i = 0; i < lambda / 2; ++i) {
      w.push_back(std::log((lambda + 1) / 2.0L) - std::log(i + 1.0L));
    }
    const long double sum = std::accumulate(w.begin(), w.end(), 0.0L);
    for (long double& weight : w) weight /= sum;
    mu_w = 1 / Dot(w, w);
  }

  Vector Direction(Vector d) const {
    for (int j = 0; j < std::min(t, m); ++j) {
      const long double c_d = std::pow(1.5L, -j) / n, projection = Dot(M[j], d);
      for (int i = 0; i < n; ++i) d[i] = (1 - c_d) * d[i] + c_d * M[j][i] * projection;
    }
    return d;
  }

  void Update(const std::vector<Vector>& z, const std::vector<double>& costs) {
    std::vector<int> order(lambda);
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](int a, int b) { return costs[a] < costs[b]; });
    Vector z_w(n), d_w(n);
    for (std::size_t k = 0; k < w.size(); ++k) {
      const Vector d = Direction(z[order[k]]);
      for (int i = 0; i < n; ++i) z_w[i] += w[k] * z[order[k]][i], d_w[i] += w[k] * d[i];
    }
    for (int i = 0; i < n; ++i) y[i] += sigma * d_w[i];
    const auto accumulate = [&](Vector& path, long double c) {
      for (int i = 0; i < n; ++i) {
        path[i] = (1 - c) * path[i] + std::sqrt(mu_w * c * (2 - c)) * z_w[i];
      }
    };
    const long double c_sigma = 2.0L * lambda / n;
    accumulate(p, c_sigma);
    for (int j = 0; j < m; ++j) accumulate(M[j], lambda * std::pow(4.0L, -j) / n);
    sigma *= std::exp(c_sigma / 2 * (Dot(p, p) / n - 1));
    ++t;
  }

  int n, lambda, m, t = 0;
  Vector w, y, p;
  std::vector<Vector> M;
  long double sigma, mu_w = 0;
};

TEST_CASE("limited_memory: forty generations agree with the paper in long double") {
  constexpr int kP = 60, kLambda = 10;
  CmaEs cma(std::vector<double>(kP, 2.0), 0.5, kLambda,
            {.covariance = CovarianceForm::kLimitedMemory});
  Reference reference(kP, kLambda, 2, 0.5);
  std::vector<double> x(kP * kLambda), costs(kLambda), normals(kP);
  for (std::uint32_t g = 0; g < 40; ++g) {
    const StreamKey key = DeriveKey(4, StreamPurpose::kSearchSampling, {g});
    cma.Ask(key, x);
    std::vector<Vector> z;
    for (int c = 0; c < kLambda; ++c) {
      FillNormals(key, static_cast<std::uint32_t>(c), normals.data(), kP);
      z.emplace_back(normals.begin(), normals.end());
      const Vector d = reference.Direction(z.back());
      for (int i = 0; i < kP; ++i) {
        const long double expected = reference.y[i] + reference.sigma * d[i];
        REQUIRE(std::abs(x[c * kP + i] - static_cast<double>(expected)) < 1e-11);
      }
      costs[c] = Ellipsoid({x.data() + c * kP, kP});
    }
    cma.Tell(costs);
    reference.Update(z, costs);
    CHECK(cma.sigma() == doctest::Approx(static_cast<double>(reference.sigma)).epsilon(1e-12));
  }
}

// Small dimensions and large populations are outside of the paper's rules.
TEST_CASE("limited_memory: solves the sphere in any dimension with small and large populations") {
  for (const int dimension : {1, 2, 10, 100}) {
    for (const int population : {5, 20, 200}) {
      const auto p = static_cast<std::size_t>(dimension);
      CmaEs cma(std::vector<double>(p, 3.0), 2, population,
                {.covariance = CovarianceForm::kLimitedMemory});
      std::vector<double> x(p * static_cast<std::size_t>(population));
      std::vector<double> costs(static_cast<std::size_t>(population));
      double best = 1;
      while (cma.generation() < 4000 && best > 1e-8) {
        const auto g = static_cast<std::uint32_t>(cma.generation());
        cma.Ask(DeriveKey(1, StreamPurpose::kSearchSampling, {g}), x);
        for (std::size_t c = 0; c < costs.size(); ++c) costs[c] = Sphere({x.data() + c * p, p});
        cma.Tell(costs);
        best = *std::min_element(costs.begin(), costs.end());
      }
      INFO(dimension, " parameters, population ", population);
      CHECK(best < 1e-8);
    }
  }
}

TEST_CASE("limited_memory: auto takes it above its dimension, and rates do not adapt with it") {
  const auto form = [](int dimension) {
    return CmaEs(std::vector<double>(static_cast<std::size_t>(dimension)), 1, 8,
                 {.covariance = CovarianceForm::kAuto})
        .covariance();
  };
  CHECK(form(kMaxFullDimension) == CovarianceForm::kFull);
  CHECK(form(kMaxFullDimension + 1) == CovarianceForm::kLimitedMemory);
  CHECK_THROWS_AS(CmaEs(std::vector<double>(9), 1, 8,
                        {.covariance = CovarianceForm::kLimitedMemory, .adapt_rates = true}),
                  InvalidInput);
}

}  // namespace
}  // namespace downpour
