// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_query/covariance_passes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "tests/kernels/gp_query_cases.h"

namespace downpour {
namespace {

// What a pass leaves in the scratch, sorted; NaN where nothing was written.
template <typename T>
std::vector<T> Leaves(const GpFactorT<T>& factor, CovariancePass last,
                      const AlignedVector<double>& x) {
  const std::size_t bytes = GpQueryScratchBytes(factor);
  AlignedVector<T> scratch(bytes / sizeof(T), std::numeric_limits<T>::quiet_NaN());
  CovariancePasses(factor, last, x.data(), scratch.data());
  std::vector<T> left;
  for (const T value : scratch) {
    if (!std::isnan(value)) left.push_back(value);
  }
  std::sort(left.begin(), left.end());
  return left;
}

template <typename T>
bool Holds(const std::vector<T>& sorted, double value, double tolerance) {
  const auto at = std::lower_bound(sorted.begin(), sorted.end(), static_cast<T>(value - tolerance));
  return at != sorted.end() && *at <= value + tolerance;
}

// Squared scaled distance of a query and a point, of the packed inputs.
template <typename T>
double Distance(const GpFactorT<T>& f, const AlignedVector<double>& x, int lane, int point) {
  double sum = 0;
  for (int k = 0; k < f.dim; ++k) {
    const double q = f.scale[k] * x[k * kTileLanes + lane] - f.centre[k];
    const double delta = q - static_cast<double>(f.inputs[PointOffset(point, k, f.dim)]);
    sum += delta * delta;
  }
  return sum;
}

template <typename T>
void CheckPasses(int n, int dim) {
  TestNumbers random(n + dim);
  const GpFactorT<T> factor = RandomFactor<T>(n, dim, random);
  const AlignedVector<double> x = RandomQueries(dim, random);
  const auto distances = Leaves(factor, CovariancePass::kDistances, x);
  const auto powers = Leaves(factor, CovariancePass::kExponentials, x);
  const auto rest = Leaves(factor, CovariancePass::kDeflation, x);
  const double eps = std::numeric_limits<T>::epsilon();
  bool all_distances = true, all_powers = true;
  for (int lane = 0; lane < kTileLanes; ++lane) {
    for (int point = 0; point < n; ++point) {
      const double d = Distance(factor, x, lane, point);
      // Coordinates are of order 1: rounding of q is, too.
      const double tolerance = (dim + 4) * eps * (1 + 4 * std::sqrt(d) + d);
      all_distances = all_distances && Holds(distances, d, tolerance);
      all_powers = all_powers && Holds(powers, std::exp2(-d), 2 * tolerance);
    }
  }
  CHECK(all_distances);
  CHECK(all_powers);
  CHECK(rest == powers);  // without deflation the pass does nothing
  CHECK(distances != powers);
}

TEST_CASE("covariance_passes: each leaves what it computes, on every target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const int dim : {3, 4, 6, 12}) {
      CAPTURE(dim);
      CheckPasses<double>(13, dim);
      CheckPasses<float>(13, dim);
    }
  });
}

TEST_CASE("covariance_passes: the deflation is a pass of its own") {
  TestNumbers random(5);
  const GpFactor32 factor = RandomFactor<float>(24, 6, random, true);
  const AlignedVector<double> x = RandomQueries(6, random);
  CHECK(Leaves(factor, CovariancePass::kDeflation, x) !=
        Leaves(factor, CovariancePass::kExponentials, x));
}

}  // namespace
}  // namespace downpour
