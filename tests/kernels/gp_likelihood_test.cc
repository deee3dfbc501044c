// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_likelihood/gp_likelihood.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "kernels/aligned.h"
#include "kernels/gp_likelihood/gp_likelihood_ref.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// Points uniform in [-spread, spread]^D over the lengthscales, targets in [-1, 1].
struct Problem {
  int n, dim, ld;
  double signal_variance, noise_variance;
  std::vector<double> scaled, targets;
  AlignedVector<double> scratch;
  std::vector<double> gradient;

  Problem(int n, int dim, double spread, double signal_variance, double noise_variance)
      : n(n),
        dim(dim),
        ld((n + 7) / 8 * 8 + 3),
        signal_variance(signal_variance),
        noise_variance(noise_variance),
        scaled(1 + dim * ld),
        targets(n),
        scratch(GpLikelihoodScratch(n), std::numeric_limits<double>::quiet_NaN()),
        gradient(dim + 2, 7.0) {
    TestNumbers random(n + 1000 * dim);
    for (double& x : scaled) x = spread * random();
    for (double& y : targets) y = random();
  }
  // At an address that no vector is aligned to.
  double* x() { return scaled.data() + 1; }
  double Compute() {
    return GpLikelihood(n, dim, x(), ld, targets.data(), signal_variance, noise_variance,
                        scratch.data(), gradient.data());
  }
  double Value() {
    return GpLikelihood(n, dim, x(), ld, targets.data(), signal_variance, noise_variance,
                        scratch.data(), nullptr);
  }
};

// Worst errors of value and gradient, in units of
//   eps (1 + n sigma_f^2 / sigma_n^2) (2 D + 8) magnitude:
// K's condition number is at most the middle factor, an entry's error as stated for exp and D sums.
void WorstErrors(Problem& problem, double* value, double* gradient) {
  const GpLikelihoodReference ref =
      LikelihoodReference(problem.n, problem.dim, problem.x(), problem.ld, problem.targets.data(),
                          problem.signal_variance, problem.noise_variance);
  const double unit = kEps * (2 * problem.dim + 8) *
                      (1 + problem.n * problem.signal_variance / problem.noise_variance);
  const double computed = problem.Compute();
  *value = static_cast<double>(std::abs(computed - ref.value) / (unit * ref.value_magnitude));
  *gradient = 0;
  for (int p = 0; p < problem.dim + 2; ++p) {
    const long double error = std::abs(problem.gradient[p] - ref.gradient[p]);
    // Where every term underflows, so may the error.
    const long double bound =
        unit * ref.magnitude[p] + std::numeric_limits<double>::denorm_min() * problem.n;
    *gradient = std::max(*gradient, static_cast<double>(error / bound));
  }
}

TEST_CASE("gp_likelihood: matches the long-double reference for every size, D and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    // All remainders of block rows (8 on AVX-512) and of tiles (3 block rows).
    for (const int n : {1, 2, 3, 7, 8, 9, 15, 16, 17, 23, 24, 25, 31, 33, 40, 41, 56, 64, 65, 80}) {
      for (const int dim : {1, 2, 6, 13}) {
        for (const double noise : {1e-6, 0.01, 4.0}) {
          CAPTURE(n);
          CAPTURE(dim);
          CAPTURE(noise);
          Problem problem(n, dim, noise < 1 ? 1.0 : 4.0, 2.5, noise);
          double value = 0, gradient = 0;
          WorstErrors(problem, &value, &gradient);
          CHECK(value <= 1);
          CHECK(gradient <= 1);
        }
      }
    }
  });
}

TEST_CASE("gp_likelihood: the value alone has the bits of the value with its gradient") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const int n : {1, 9, 40, 75}) {
      CAPTURE(n);
      Problem problem(n, 3, 1.0, 1.0, 0.01);
      const double value = problem.Compute();
      CHECK(problem.Value() == value);
    }
  });
}

TEST_CASE("gp_likelihood: what lies beyond n changes no bit") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const int n : {1, 5, 9, 30, 49}) {
      CAPTURE(n);
      Problem problem(n, 2, 1.0, 1.0, 0.01);
      const double value = problem.Compute();
      const std::vector<double> gradient = problem.gradient;
      for (int d = 0; d < 2; ++d) {
        for (int i = n; i < problem.ld; ++i) problem.x()[d * problem.ld + i] = 1e300;
      }
      CHECK(problem.Compute() == value);
      CHECK(problem.gradient == gradient);
    }
  });
}

TEST_CASE("gp_likelihood: one point has the closed form") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    Problem problem(1, 1, 1.0, 3.0, 0.5);
    problem.targets[0] = 2;
    const double value = problem.Compute();
    CHECK(value == doctest::Approx(-2 / 3.5 - 0.5 * std::log(2 * 3.14159265358979323846 * 3.5))
                       .epsilon(16 * kEps));
    const double slope = 4 / (3.5 * 3.5) - 1 / 3.5;  // alpha^2 - K^-1
    CHECK(problem.gradient[0] == 0);
    CHECK(problem.gradient[1] == doctest::Approx(3.0 * slope).epsilon(32 * kEps));
    CHECK(problem.gradient[2] == doctest::Approx(0.5 * slope).epsilon(32 * kEps));
  });
}

TEST_CASE("gp_likelihood: is NaN, the gradient untouched, where K has no Cholesky factor") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const int duplicate : {1, 8, 29}) {
      CAPTURE(duplicate);
      Problem problem(30, 1, 4.0, 1.0, 0.0);
      // A negative "noise" takes a pivot below zero, a duplicate's to rounding.
      problem.noise_variance = -1e-6;
      problem.x()[duplicate] = problem.x()[0];
      CHECK(std::isnan(problem.Compute()));
      CHECK(problem.gradient == std::vector<double>(3, 7.0));
    }
  });
}

}  // namespace
}  // namespace downpour
