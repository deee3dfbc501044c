// SPDX-License-Identifier: Apache-2.0
#include "kernels/se_product/se_product.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "kernels/aligned.h"
#include "kernels/se_product/se_product_ref.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// s >= 0 for most pairs, a little or far above it; a few below.
struct Problem {
  SeProduct product;
  AlignedVector<double> u, v, p, b, row_weights, column_weights, weights, scratch;
  AlignedVector<double> rows, columns, moments;

  Problem(int n, int dim, bool triangle) {
    const int ld = (n + kSeProductPad - 1) / kSeProductPad * kSeProductPad;
    TestNumbers random(n + 1000 * dim);
    const auto fill = [&](AlignedVector<double>* x, int size) {
      x->resize(size);
      for (double& e : *x) e = random();
    };
    fill(&u, ld);
    fill(&v, ld);
    fill(&p, ld * dim);
    fill(&b, ld * dim);
    for (double& e : u) e = 2 * e + 2;
    if (n > 2) u[n / 2] = 2000;
    product = {
        .n = n, .dim = dim, .ld = ld, .u = u.data(), .v = v.data(), .p = p.data(), .b = b.data()};
    fill(&row_weights, ld);
    fill(&column_weights, ld);
    fill(&weights, ld * ld);
    for (int i = 0; i < ld; ++i) {
      if (i >= n) row_weights[i] = column_weights[i] = 0;
      for (int j = 0; j < ld; ++j) {
        if (j > i || i >= n) weights[i * ld + j] = 0;
      }
    }
    if (triangle) {
      product.weights = weights.data();
    } else {
      product.row_weights = row_weights.data();
      product.column_weights = column_weights.data();
    }
    // What is not written stays NaN.
    const double nan = std::numeric_limits<double>::quiet_NaN();
    scratch.assign(SeProductScratch(ld), nan);
    rows.assign(ld, nan);
    columns.assign(ld, nan);
    moments.assign(ld * dim, nan);
  }

  void Compute() {
    SeProductSums(product, scratch.data(), {rows.data(), columns.data(), moments.data()});
  }
};

// Worst error in units of the header's bound.
double WorstError(const Problem& x) {
  const SeProductReference ref = ReferenceSeProduct(x.product);
  const int n = x.product.n, dim = x.product.dim;
  const double unit = kEps * (8 + n + (dim + 2) * static_cast<double>(ref.exponent_size));
  double worst = 0;
  const auto compare = [&](double value, long double truth, long double size) {
    const double bound = unit * static_cast<double>(size) + n * std::numeric_limits<double>::min();
    const double error = static_cast<double>(std::abs(value - truth)) / bound;
    worst = std::isnan(error) ? HUGE_VAL : std::max(worst, error);
  };
  for (int i = 0; i < n; ++i) {
    compare(x.rows[i], ref.rows[i], ref.row_sizes[i]);
    compare(x.columns[i], ref.columns[i], ref.column_sizes[i]);
    for (int k = 0; k < dim; ++k) {
      compare(x.moments[i * dim + k], ref.moments[i * dim + k], ref.moment_sizes[i * dim + k]);
    }
  }
  return worst;
}

TEST_CASE("se_product: matches the long-double reference for every size, D and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const int n : {0, 1, 2, 3, 4, 5, 7, 8, 9, 12, 15, 16, 17, 31, 40, 63}) {
      for (const int dim : {1, 2, 3, 4, 6, 7}) {
        for (const bool triangle : {false, true}) {
          CAPTURE(n);
          CAPTURE(dim);
          CAPTURE(triangle);
          Problem problem(n, dim, triangle);
          problem.Compute();
          CHECK(WorstError(problem) <= 1);
          for (int i = n; i < problem.product.ld; ++i) {
            CHECK(problem.rows[i] == 0);
            CHECK(problem.columns[i] == 0);
          }
        }
      }
    }
  });
}

TEST_CASE("se_product: the row sums alone have the bits of those with all sums") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const bool triangle : {false, true}) {
      Problem problem(37, 5, triangle);
      problem.Compute();
      const AlignedVector<double> rows = problem.rows;
      SeProductSums(problem.product, problem.scratch.data(), {.rows = problem.rows.data()});
      CHECK(problem.rows == rows);
    }
  });
}

}  // namespace
}  // namespace downpour
