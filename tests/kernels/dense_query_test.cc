// SPDX-License-Identifier: Apache-2.0
#include "kernels/dense_query/dense_query.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "kernels/dense_query/dense_query_ref.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

template <typename T>
AlignedVector<T> Random(std::size_t size, double spread, TestNumbers& random) {
  AlignedVector<T> values(size);
  for (T& x : values) x = static_cast<T>(spread * random());
  return values;
}

// Column `q` of rows of n_queries.
template <typename T>
std::vector<T> Query(const AlignedVector<T>& rows, int n_queries, int q) {
  std::vector<T> query;
  for (std::size_t at = q; at < rows.size(); at += n_queries) query.push_back(rows[at]);
  return query;
}

// Largest error of an entry in units of its bound.
template <typename T>
double WorstCovariance(int n_queries, int n, int dim, double spread, TestNumbers& random) {
  const auto queries = Random<T>(dim * n_queries, spread, random);
  // One element on: points need no alignment.
  const auto points = Random<T>(n * dim + 1, spread, random);
  AlignedVector<T> e(n * n_queries, T(7));
  QueryCovariances(n_queries, n, dim, queries.data(), points.data() + 1, e.data());
  double worst = 0;
  for (int q = 0; q < n_queries; ++q) {
    const std::vector<T> query = Query(queries, n_queries, q);
    for (int i = 0; i < n; ++i) {
      const long double want = QueryCovarianceRef(dim, query.data(), &points[1 + i * dim]);
      const long double bound =
          (dim + 4) * std::numeric_limits<T>::epsilon() * (1 - std::log2(want)) * want +
          std::numeric_limits<T>::min();
      const double error = static_cast<double>(std::abs(e[i * n_queries + q] - want) / bound);
      if (!(error <= worst)) worst = error;  // NaN counts as wrong
    }
  }
  return worst;
}

TEST_CASE_TEMPLATE("dense_query: covariances match the long-double reference for every size", T,
                   double, float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(1);
    for (const int tiles : {1, 2, 5, 11}) {
      for (const int n : {1, 2, 7, 8, 9}) {
        for (const int dim : {1, 4, 6, 13}) {
          for (const double spread : {0.01, 0.3, 3.0}) {
            CAPTURE(tiles);
            CAPTURE(n);
            CAPTURE(dim);
            CAPTURE(spread);
            CHECK(WorstCovariance<T>(tiles * kTileLanes, n, dim, spread, random) <= 1);
          }
        }
      }
    }
  });
}

TEST_CASE_TEMPLATE("dense_query: covariance 1 at a point itself, 0 far from it", T, double, float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    const T points[] = {T(0.3), T(-1e3), std::numeric_limits<T>::max()};
    const AlignedVector<T> queries(kTileLanes, T(0.3));
    AlignedVector<T> e(3 * kTileLanes);
    QueryCovariances(kTileLanes, 3, 1, queries.data(), points, e.data());
    for (int q = 0; q < kTileLanes; ++q) {
      CHECK(e[q] == 1);
      CHECK(e[kTileLanes + q] == 0);
      CHECK(e[2 * kTileLanes + q] == 0);
    }
  });
}

TEST_CASE_TEMPLATE("dense_query: a query that is not finite gives NaN in its own lane only", T,
                   double, float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(2);
    constexpr int kQueries = 2 * kTileLanes, kPoints = 5, kDim = 3;
    const auto points = Random<T>(kPoints * kDim, 1, random);
    for (const double bad : {std::nan(""), HUGE_VAL, -HUGE_VAL}) {
      auto queries = Random<T>(kDim * kQueries, 1, random);
      queries[kQueries + 50] = static_cast<T>(bad);
      AlignedVector<T> e(kPoints * kQueries);
      QueryCovariances(kQueries, kPoints, kDim, queries.data(), points.data(), e.data());
      AlignedVector<double> variance(kQueries);
      QueryVariances(kQueries, kPoints, 1.0, e.data(), variance.data());
      for (int q = 0; q < kQueries; ++q) {
        for (int i = 0; i < kPoints; ++i) CHECK(std::isnan(e[i * kQueries + q]) == (q == 50));
        CHECK(std::isnan(variance[q]) == (q == 50));
      }
    }
  });
}

TEST_CASE_TEMPLATE("dense_query: variances match the long-double reference and are never negative",
                   T, double, float) {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(3);
    for (const int tiles : {1, 2, 5}) {
      for (const int n : {1, 7, 8, 9, 320}) {
        CAPTURE(tiles);
        CAPTURE(n);
        const int n_queries = tiles * kTileLanes;
        const auto v = Random<T>(n * n_queries, 1 / std::sqrt(n), random);
        // About half of the queries are clamped by the smaller one.
        for (const double signal_variance : {0.33, 2.0}) {
          AlignedVector<double> variance(n_queries, -7);
          QueryVariances(n_queries, n, signal_variance, v.data(), variance.data());
          double worst = 0;
          for (int q = 0; q < n_queries; ++q) {
            const long double want =
                QueryVarianceRef(n, signal_variance, Query(v, n_queries, q).data());
            const long double bound = (n + 2) * std::numeric_limits<double>::epsilon() *
                                      (signal_variance + (signal_variance - want));
            worst = std::max(
                worst, static_cast<double>(std::abs(variance[q] - std::max(want, 0.0L)) / bound));
            CHECK(variance[q] >= 0);
          }
          CHECK(worst <= 1);
        }
      }
    }
  });
}

}  // namespace
}  // namespace downpour
