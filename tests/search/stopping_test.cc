// SPDX-License-Identifier: Apache-2.0
// Every stopping criterion of the tutorial (arXiv 1604.00772, appendix B.3) holds when its own
// definition does, and at no generation before.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "engine/search/cma_es.h"
#include "engine/search/fitness_history.h"
#include "engine/search/full_covariance.h"
#include "tests/search/cma_es_reference.h"
#include "tests/search/test_functions.h"

namespace downpour {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr CmaEsTolerances kOff{0, 0, kInf, kInf};
using Window = std::vector<double>;

StreamKey Key(std::uint32_t generation) {
  return DeriveKey(8, StreamPurpose::kSearchSampling, {generation});
}

double Median(Window values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

bool IsFlat(const Window& best, double last_worst, int window, double tolerance) {
  if (static_cast<int>(best.size()) < window) return false;
  Window recent(best.end() - window, best.end());
  recent.push_back(last_worst);
  std::sort(recent.begin(), recent.end());
  return recent.back() - recent.front() < tolerance;
}

// The last 20 % of the generations, at least 120 + 30 P / lambda: their newest 30 % of neither
// history has a better median than the oldest 30 %.
bool IsStagnant(const Window& best, const Window& median, int dimension, int population) {
  const int generations = static_cast<int>(best.size());
  const int window = std::max(120 + 30 * dimension / population, generations / 5);
  if (generations < window) return false;
  const int part = 3 * window / 10;
  for (const Window& values : {best, median}) {
    if (Median({values.end() - part, values.end()}) <
        Median({values.end() - window, values.end() - window + part})) {
      return false;
    }
  }
  return true;
}

TEST_CASE(
    "stopping: TolHistFun, EqualFunValues and Stagnation hold just when their definition does") {
  constexpr int kP = 7, kLambda = 9;
  constexpr int kWindow = 10 + 24;  // ceil(30 * 7 / 9) = 24
  int flat = 0, equal = 0, stagnant = 0, moving = 0;
  for (std::uint32_t trial = 0; trial < 6; ++trial) {
    FitnessHistory history(kP, kLambda);
    Window best, median;
    for (std::uint32_t g = 0; g < 1500; ++g) {
      Window costs(kLambda);
      FillNormals(DeriveKey(trial, StreamPurpose::kEvaluate, {g}), 0, costs.data(), kLambda);
      // It falls, then lies flat; in odd trials in steps, so that values repeat.
      const double level = std::max(0.0, 400.0 - g), noise = trial < 2 ? 0 : 0.01 * trial;
      for (double& cost : costs) {
        cost = level + noise * cost;
        if (trial % 2 == 1) cost = std::round(10 * cost) / 10;
      }
      history.Append(costs);
      const auto [low, high] = std::minmax_element(costs.begin(), costs.end());
      best.push_back(*low);
      median.push_back(Median(costs));
      for (const double tolerance : {1e-12, 0.05, 0.15}) {
        CHECK(history.IsFlat(tolerance) == IsFlat(best, *high, kWindow, tolerance));
      }
      const bool is_equal = best.size() >= kWindow &&
                            std::count(best.end() - kWindow, best.end(), best.back()) == kWindow;
      const bool is_stagnant = IsStagnant(best, median, kP, kLambda);
      CHECK(history.HasEqualBest() == is_equal);
      CHECK(history.IsStagnant() == is_stagnant);
      flat += IsFlat(best, *high, kWindow, 0.05);
      equal += is_equal;
      stagnant += is_stagnant;
      moving += !is_equal && !is_stagnant;
    }
  }
  for (const int count : {flat, equal, stagnant, moving}) CHECK(count > 500);
}

// Runs CmaEs beside the long-double reference until `criterion` holds of the reference; the run
// must stop then, for that reason, and not before.
void CheckStopsWith(const std::string& name, const CmaEsTolerances& tolerances,
                    const TestFunction& function,
                    const std::function<bool(const CmaEsReference&)>& criterion) {
  constexpr int kP = 4, kLambda = 8;
  const std::vector<double> start(kP, 1.5);
  CmaEs cma(start, 0.5, kLambda, {.tolerances = tolerances});
  CmaEsReference reference(CmaEsReference::Vector::Constant(kP, 1.5L), 0.5L, kLambda);
  std::vector<double> x(kP * kLambda), costs(kLambda), z(kP);
  bool expected = false;
  while (!expected && cma.generation() < 2000) {
    const auto generation = static_cast<std::uint32_t>(cma.generation());
    cma.Ask(Key(generation), x);
    const auto factor = reference.Factor();
    std::vector<CmaEsReference::Vector> steps;
    for (int c = 0; c < kLambda; ++c) {
      FillNormals(Key(generation), static_cast<std::uint32_t>(c), z.data(), kP);
      steps.push_back(factor * Eigen::Map<Eigen::VectorXd>(z.data(), kP).cast<long double>());
      costs[c] = function({x.data() + c * kP, kP});
    }
    cma.Tell(costs);
    reference.Update(steps, costs);
    expected = criterion(reference);
    REQUIRE(cma.stop() == (expected ? name : ""));
  }
  CHECK(expected);
  CHECK(cma.generation() > 20);
}

TEST_CASE("stopping: TolX, TolXUp and ConditionCov hold just when their definition does") {
  CmaEsTolerances tolerances = kOff;
  tolerances.x = 1e-4;
  CheckStopsWith("TolX", tolerances, Sphere, [](const CmaEsReference& r) {
    const long double limit = 1e-4L * 0.5L;
    return (r.sigma * r.C.diagonal().cwiseSqrt()).maxCoeff() < limit &&
           (r.sigma * r.p_c.cwiseAbs()).maxCoeff() < limit;
  });
  tolerances = kOff;
  tolerances.x_up = 1e3;
  CheckStopsWith(
      "TolXUp", tolerances, [](auto x) { return x[0] + x[1]; },
      [](const CmaEsReference& r) {
        Eigen::SelfAdjointEigenSolver<CmaEsReference::Matrix> eigen(r.axes_C);
        return r.sigma * std::sqrt(eigen.eigenvalues().maxCoeff()) > 1e3L * 0.5L;
      });
  tolerances = kOff;
  tolerances.condition_cov = 1e3;
  CheckStopsWith("ConditionCov", tolerances, Ellipsoid, [](const CmaEsReference& r) {
    Eigen::SelfAdjointEigenSolver<CmaEsReference::Matrix> eigen(r.axes_C);
    return eigen.eigenvalues().maxCoeff() > 1e3L * eigen.eigenvalues().minCoeff();
  });
}

TEST_CASE("stopping: a matrix that is no longer positive definite is infinitely ill-conditioned") {
  constexpr int kP = 8, kLambda = 10;
  const StrategyParameters parameters = MakeStrategyParameters(CovarianceForm::kFull, kP, kLambda);
  FullCovariance covariance(parameters, kP, kLambda);
  const Eigen::MatrixXd z = Eigen::MatrixXd::Ones(kP, kLambda), y = 0 * z;
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(kP);
  const int ranking[kLambda] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9};
  // The factor is due, the axes are not.
  const int due = static_cast<int>(1 / (kP * (parameters.c_1 + parameters.c_mu))) + 1;
  covariance.Update({parameters, z, y, ranking, zero, zero, 1, due});
  CHECK(covariance.condition() == 1);
  covariance.Update({parameters, z, y, ranking, zero, zero, -1, 2 * due});  // C = -I
  CHECK(covariance.condition() == kInf);
  Eigen::MatrixXd sampled(kP, kLambda);
  covariance.Transform(z, &sampled);
  CHECK(sampled == z);  // by the last factor there was
}

// The criterion that the first generation meets on a sphere around `mean`.
std::string FirstStop(const std::vector<double>& mean, double sigma) {
  CmaEs cma(mean, sigma, 8, {.tolerances = kOff});
  std::vector<double> x(mean.size() * 8), costs(8);
  cma.Ask(Key(0), x);
  for (std::size_t c = 0; c < 8; ++c) costs[c] = Sphere({x.data() + c * mean.size(), mean.size()});
  cma.Tell(costs);
  return std::string(cma.stop());
}

TEST_CASE("stopping: NoEffectCoord and NoEffectAxis hold where a step is lost to rounding") {
  // A mean above 2^52 is rounded to whole numbers: 0.2 of a standard deviation of about 1 is lost,
  // of about 8 not.
  const double rounded = std::ldexp(1.0, 52) + 1000;
  CHECK(FirstStop({rounded, 0, 0}, 1) == "NoEffectCoord");
  CHECK(FirstStop({rounded, 0, 0}, 8).empty());
  // 0.1 of it along an axis is lost when no coordinate changes, though 0.2 of it in one would.
  CHECK(FirstStop({rounded, rounded, rounded}, 1) == "NoEffectAxis");
  CHECK(FirstStop({rounded, rounded, rounded}, 3) == "NoEffectAxis");
  CHECK(FirstStop({rounded, rounded, rounded}, 16).empty());
}

TEST_CASE("stopping: MaxEvaluations holds from the generation that reaches it") {
  for (const int limit : {1, 24, 25, 80}) {
    CmaEsTolerances tolerances;
    tolerances.max_evaluations = limit;
    CmaEs cma(std::vector<double>(3, 1.0), 1, 8, {.tolerances = tolerances});
    std::vector<double> x(24), costs = {1, 2, 3, 4, 5, 6, 7, 8};
    for (int told = 8; told <= 80; told += 8) {
      cma.Ask(Key(0), x);
      cma.Tell(costs);
      CHECK(cma.stop() == (told >= limit ? "MaxEvaluations" : ""));
    }
  }
}

}  // namespace
}  // namespace downpour
