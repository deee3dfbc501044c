// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/gradient_search.h"

#include <doctest/doctest.h>

#include <atomic>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "engine/errors.h"

namespace downpour {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Two hills of heights 3 at (1, -2, 0) and 1 at -(1, -2, 0): sum of h exp(-|x - c|^2 / 2).
double Hills(std::span<const double> x, std::span<double> gradient) {
  std::fill(gradient.begin(), gradient.end(), 0.0);
  double value = 0;
  for (const double side : {1.0, -1.0}) {
    const double centre[3] = {side, -2 * side, 0};
    double squares = 0;
    for (int i = 0; i < 3; ++i) squares += std::pow(x[i] - centre[i], 2);
    const double hill = (side > 0 ? 3 : 1) * std::exp(-squares / 2);
    value += hill;
    for (int i = 0; i < 3; ++i) gradient[i] -= hill * (x[i] - centre[i]);
  }
  return value;
}

ValueAndGradient MakeHills() { return Hills; }

// -(1 - x)^2 - 100 (y - x^2)^2: Rosenbrock's valley upside down, its top 0 at (1, 1).
double Ridge(std::span<const double> x, std::span<double> gradient) {
  const double a = 1 - x[0], b = x[1] - x[0] * x[0];
  gradient[0] = 2 * a + 400 * x[0] * b;
  gradient[1] = -200 * b;
  return -a * a - 100 * b * b;
}

GradientSearchResult Search(const std::vector<std::vector<double>>& starts,
                            const std::function<ValueAndGradient()>& make, int evaluations = 300,
                            int threads = 1, double bound = 5) {
  return SearchByGradient({.bound = bound, .evaluations = evaluations, .threads = threads}, starts,
                          make, {}, nullptr);
}

std::string ErrorOf(const std::function<void()>& action) {
  try {
    action();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

TEST_CASE("gradient search: each start climbs its own hill, the highest one wins") {
  const GradientSearchResult result = Search({{-1.5, 1.5, 0.5}, {0.5, -1.5, 0.3}}, MakeHills);
  REQUIRE(result.runs.size() == 2);
  CHECK(result.best == 1);
  // Near a top the value is within half the squared distance of it: 1e-6 of value, 1e-3 of place.
  CHECK(result.runs[0].value == doctest::Approx(1).epsilon(1e-3));
  CHECK(result.runs[1].value == doctest::Approx(3).epsilon(1e-3));
  const double top[3] = {1, -2, 0};
  for (int i = 0; i < 3; ++i) CHECK(std::abs(result.runs[1].parameters[i] - top[i]) < 2e-3);
  for (const GradientSearchRun& run : result.runs) CHECK(run.stop == "converged");
}

TEST_CASE("gradient search: follows a curved ridge to its top") {
  const auto result = Search({{-1.2, 1}}, [] { return ValueAndGradient(Ridge); });
  CHECK(result.runs[0].value > -1e-4);
  CHECK(result.runs[0].evaluations < 100);
}

TEST_CASE("gradient search: the top on a bound is found, starts beyond it are clipped") {
  const auto slope = [] {
    return [](std::span<const double> x, std::span<double> gradient) {
      CHECK(std::abs(x[0]) <= 2);
      gradient[0] = 1;
      return x[0];
    };
  };
  CHECK(Search({{-7}}, slope, 50, 1, 2).runs[0].parameters[0] == 2);
}

TEST_CASE("gradient search: the budget ends a start up to the line search under way") {
  const auto result = Search(
      {{-1.2, 1}}, [] { return ValueAndGradient(Ridge); }, 9);
  CHECK(result.runs[0].stop == "budget");
  CHECK(result.runs[0].evaluations >= 9);
  CHECK(result.runs[0].evaluations <= 9 + 20);
}

TEST_CASE("gradient search: the same bits on 1, 2 and 5 threads") {
  std::vector<std::vector<double>> starts;
  for (int i = 0; i < 7; ++i) starts.push_back({0.3 * i - 1, 1.4 - 0.5 * i, 0.1 * i});
  const GradientSearchResult one = Search(starts, MakeHills);
  for (const int threads : {2, 5}) {
    const GradientSearchResult many = Search(starts, MakeHills, 300, threads);
    CHECK(many.best == one.best);
    for (std::size_t i = 0; i < starts.size(); ++i) {
      CHECK(many.runs[i].parameters == one.runs[i].parameters);
      CHECK(many.runs[i].value == one.runs[i].value);
      CHECK(many.runs[i].evaluations == one.runs[i].evaluations);
    }
  }
}

TEST_CASE("gradient search: steps to where there is no value are taken back") {
  // The logarithm has none below 0.
  const auto log_hill = [] {
    return [](std::span<const double> x, std::span<double> gradient) {
      gradient[0] = 1 / x[0] - 1;
      return std::log(x[0]) - x[0];
    };
  };
  const GradientSearchResult result = Search({{0.01}}, log_hill);
  CHECK(std::abs(result.runs[0].parameters[0] - 1) < 2e-3);
  const auto slope_only = [] {
    return [](std::span<const double>, std::span<double> gradient) {
      gradient[0] = std::numeric_limits<double>::quiet_NaN();
      return 1.0;
    };
  };
  CHECK(ErrorOf([&] { Search({{0}}, slope_only); }) ==
        "gradient search: the value is finite at no start: must be at one at least");
}

TEST_CASE("gradient search: a start without a value loses against any other") {
  const auto half = [] {
    return [](std::span<const double> x, std::span<double> gradient) {
      gradient[0] = -2 * x[0];
      return x[0] < 0 ? -kInfinity : -x[0] * x[0] - 1e9;
    };
  };
  const GradientSearchResult result = Search({{-1}, {1}}, half);
  CHECK(result.best == 1);
  CHECK(result.runs[0].value == -kInfinity);
}

TEST_CASE("gradient search: progress counts every evaluation, stop is looked at before each") {
  std::int64_t calls = 0;
  GradientSearchProgress last;
  const auto count = [&](const GradientSearchProgress& progress) {
    ++calls;
    CHECK(progress.evaluations == calls);
    last = progress;
  };
  const GradientSearchResult result =
      SearchByGradient({.threads = 2}, {{0.5, -1, 0}, {-0.5, 1, 0}}, MakeHills, count, nullptr);
  CHECK(calls == result.runs[0].evaluations + result.runs[1].evaluations);
  CHECK(last.budget == 600);
  CHECK(last.best_value == result.runs[result.best].value);

  std::atomic<bool> stop = false;
  calls = 0;
  const auto stop_at_third = [&](const GradientSearchProgress&) { stop = ++calls == 3; };
  CHECK_THROWS_AS(SearchByGradient({}, {{0.5, -1, 0}}, MakeHills, stop_at_third, &stop),
                  Interrupted);
  CHECK(calls == 3);
}

TEST_CASE("gradient search: what the objective throws comes out") {
  const auto broken = [] {
    return [](std::span<const double>, std::span<double>) -> double {
      throw std::runtime_error("broken");
    };
  };
  CHECK(ErrorOf([&] { Search({{0}}, broken); }) == "broken");
}

TEST_CASE("gradient search: bad arguments are refused") {
  const auto error = [](const GradientSearchOptions& options,
                        const std::vector<std::vector<double>>& starts) {
    return ErrorOf([&] { SearchByGradient(options, starts, MakeHills, {}, nullptr); });
  };
  CHECK(error({.bound = 0}, {{0, 0, 0}}) ==
        "gradient search: bound is 0.000000, must be finite and > 0");
  CHECK(error({.evaluations = 0}, {{0, 0, 0}}) ==
        "gradient search: evaluations is 0, must be >= 1");
  CHECK(error({.threads = 0}, {{0, 0, 0}}) == "gradient search: threads is 0, must be >= 1");
  CHECK(error({}, {}) == "gradient search: no start: must have one at least");
  CHECK(error({}, {{0, 0, 0}, {0}}) ==
        "gradient search: a start differs from the first in size or is not finite: must be 3 "
        "finite numbers");
  CHECK(error({}, {{0, 0, kInfinity}}).ends_with("must be 3 finite numbers"));
}

}  // namespace
}  // namespace downpour
