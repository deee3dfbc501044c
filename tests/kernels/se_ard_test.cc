// SPDX-License-Identifier: Apache-2.0
#include "kernels/se_ard/se_ard.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "kernels/se_ard/se_ard_ref.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// One problem with leading dimensions larger than n, at addresses that no vector is aligned to.
struct Problem {
  int n, dim, ld, ldk;
  std::vector<double> scaled;
  std::vector<double> k;
  Problem(int n, int dim, double spread, TestNumbers& random)
      : n(n), dim(dim), ld(n + 3), ldk(n + 5), scaled(1 + dim * ld), k(1 + n * ldk, 7.0) {
    for (double& x : scaled) x = spread * random();
  }
  const double* x() const { return scaled.data() + 1; }
  double* Compute(double signal_variance) {
    SeArdCovarianceLower(n, dim, x(), ld, signal_variance, k.data() + 1, ldk);
    return k.data() + 1;
  }
};

TEST_CASE("se_ard: matches the long-double reference for every size, dimension and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(3);
    for (const int n : {0, 1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 33}) {
      for (const int dim : {1, 2, 6, 13}) {
        for (const double spread : {0.1, 1.0, 8.0}) {
          Problem problem(n, dim, spread, random);
          const double* k = problem.Compute(2.5);
          std::vector<long double> ref(problem.k.size());
          SeArdCovarianceLowerRef(n, dim, problem.x(), problem.ld, 2.5, ref.data(), problem.ldk);
          double worst = 0;  // in units of the bound
          for (int j = 0; j < n; ++j) {
            for (int i = j; i < n; ++i) {
              const long double exact = ref[j * problem.ldk + i];
              const double exponent = static_cast<double>(std::log(2.5L / exact));
              const double bound = (2 * dim + 8) * kEps * (1 + exponent) * exact +
                                   std::numeric_limits<double>::denorm_min();
              const double error = std::abs(static_cast<double>(k[j * problem.ldk + i] - exact));
              worst = std::max(worst, error / bound);
            }
          }
          CAPTURE(n);
          CAPTURE(dim);
          CAPTURE(spread);
          CHECK(worst <= 1);
        }
      }
    }
  });
}

TEST_CASE("se_ard: writes the lower triangle only") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(4);
    for (const int n : {0, 1, 3, 8, 9, 21}) {
      Problem problem(n, 2, 1.0, random);
      problem.Compute(1.0);
      CHECK(problem.k[0] == 7.0);
      bool untouched = true;
      for (int j = 0; j < n; ++j) {
        for (int i = 0; i < problem.ldk; ++i) {
          if (i < j || i >= n) untouched &= problem.k[1 + j * problem.ldk + i] == 7.0;
        }
      }
      CHECK(untouched);
    }
  });
}

TEST_CASE("se_ard: an entry's bits do not depend on its place in the matrix") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(5);
    Problem whole(29, 6, 1.0, random);
    const double* k = whole.Compute(1.7);
    for (int first = 0; first < 29; first += 3) {
      for (int n = 1; first + n <= 29; ++n) {
        std::vector<double> part(n * n);
        SeArdCovarianceLower(n, 6, whole.x() + first, whole.ld, 1.7, part.data(), n);
        bool equal = true;
        for (int j = 0; j < n; ++j) {
          for (int i = j; i < n; ++i) {
            equal &= part[j * n + i] == k[(j + first) * whole.ldk + i + first];
          }
        }
        CAPTURE(first);
        CAPTURE(n);
        CHECK(equal);
      }
    }
  });
}

TEST_CASE("se_ard: the diagonal is the signal variance, far points have covariance zero") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    const std::vector<double> scaled = {0, 1e3, -1e200, 0.5};
    std::vector<double> k(16);
    SeArdCovarianceLower(4, 1, scaled.data(), 4, 0.3, k.data(), 4);
    for (int i = 0; i < 4; ++i) CHECK(k[5 * i] == 0.3);
    CHECK(k[1] == 0);
    CHECK(k[2] == 0);
    CHECK(k[3] == doctest::Approx(0.3 * std::exp(-0.125)));
  });
}

}  // namespace
}  // namespace downpour
