// SPDX-License-Identifier: Apache-2.0
#include "kernels/covariance/covariance.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "kernels/covariance/covariance_ref.h"
#include "kernels/philox/philox.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

std::vector<double> Normals(std::uint32_t stream, int n) {
  std::vector<double> values(n);
  FillNormals({stream, 1}, 0, values.data(), values.size());
  return values;
}

// Sizes around the vectors and blocks of every target.
constexpr int kSizes[] = {1, 2, 3, 4, 5, 7, 8, 9, 12, 13, 23, 24, 25, 47, 49, 71};
constexpr int kColumns[] = {0, 1, 3, 4, 5, 7, 8, 9, 16, 17};

TEST_CASE("covariance: L Z matches the long-double twin for every size, column count and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const int n : kSizes) {
      for (const int m : kColumns) {
        CAPTURE(n);
        CAPTURE(m);
        std::vector<double> l = Normals(1, n * n), y(n * m + 1, -7.0);
        const std::vector<double> z = Normals(2, n * m);
        for (int row = 0; row < n; ++row) {
          for (int k = row + 1; k < n; ++k) l[row + k * n] = 0;
        }
        TriangularProduct(n, m, l.data(), z.data(), y.data());
        for (int i = 0; i < n * m; ++i) {
          long double size;
          const auto expected =
              TriangularProductReference(n, l.data(), z.data(), i % n, i / n, &size);
          CHECK(std::abs(y[i] - expected) <= n * kEps * size);  // n roundings of the sum
        }
        CHECK(y[n * m] == -7.0);  // nothing is written beyond the end
      }
    }
  });
}

TEST_CASE("covariance: the symmetric update matches the long-double twin for every size") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const int n : kSizes) {
      for (const int k : kColumns) {
        CAPTURE(n);
        CAPTURE(k);
        constexpr double kDecay = 0.75;
        const std::vector<double> a = Normals(3, n * k), old = Normals(4, n * n);
        std::vector<double> weights(k), c = old;
        for (int i = 0; i < k; ++i) weights[i] = i - 2;
        c.push_back(-7.0);
        SymmetricProduct(n, k, kDecay, weights.data(), a.data(), c.data());
        for (int column = 0; column < n; ++column) {
          for (int row = 0; row < n; ++row) {
            const int at = row + column * n;
            if (row < column && c[at] == old[at]) continue;  // left
            long double size;
            const auto expected = SymmetricProductReference(n, k, kDecay, weights.data(), a.data(),
                                                            old[at], row, column, &size);
            CHECK(std::abs(c[at] - expected) <= (k + 2) * kEps * size);
          }
        }
        CHECK(c[n * n] == -7.0);
      }
    }
  });
}

}  // namespace
}  // namespace downpour
