// SPDX-License-Identifier: Apache-2.0
#include "engine/search/cma_es.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "tests/search/cma_es_reference.h"
#include "tests/search/test_functions.h"

namespace downpour {
namespace {

StreamKey SamplingKey(std::uint64_t seed, int generation) {
  return DeriveKey(seed, StreamPurpose::kSearchSampling, {static_cast<std::uint32_t>(generation)});
}

// One generation; returns the best cost.
double Step(CmaEs& cma, const TestFunction& function, std::uint64_t seed) {
  const auto p = static_cast<std::size_t>(cma.dimension());
  const auto lambda = static_cast<std::size_t>(cma.population());
  std::vector<double> x(p * lambda), costs(lambda);
  cma.Ask(SamplingKey(seed, cma.generation()), x);
  for (std::size_t c = 0; c < lambda; ++c) costs[c] = function({x.data() + c * p, p});
  cma.Tell(costs);
  return *std::min_element(costs.begin(), costs.end());
}

// Median over 11 seeds of the evaluations to 1e-8; runs that stop first count as infinite.
double MedianEvaluations(const TestFunction& function, int dimension) {
  std::vector<double> evaluations;
  for (std::uint32_t seed = 1; seed <= 11; ++seed) {
    std::vector<double> mean(static_cast<std::size_t>(dimension));
    FillUniforms(DeriveKey(seed, StreamPurpose::kSearchRestart, {0}), 1, mean.data(), mean.size());
    for (double& value : mean) value = 8 * value - 4;
    CmaEs cma(mean, 2, static_cast<int>(CmaEs::DefaultPopulation(dimension)));
    double best = 1;
    while (best > 1e-8 && cma.stop().empty()) best = Step(cma, function, seed);
    evaluations.push_back(best > 1e-8 ? std::numeric_limits<double>::infinity()
                                      : cma.generation() * static_cast<double>(cma.population()));
  }
  std::nth_element(evaluations.begin(), evaluations.begin() + 5, evaluations.end());
  return evaluations[5];
}

std::string RunToStop(const TestFunction& function, const std::vector<double>& mean, double sigma,
                      const CmaEsTolerances& tolerances) {
  CmaEs cma(mean, sigma, 8, {.tolerances = tolerances});
  while (cma.stop().empty() && cma.generation() < 20000) Step(cma, function, 7);
  return std::string(cma.stop());
}

// 1e-3 is so small a step that h_sigma stalls the path of the covariance matrix.
TEST_CASE("cma_es: twenty generations agree with the papers in long double") {
  struct Case {
    double sigma;
    CovarianceForm form;
    bool adapts;
  };
  for (const Case& c : {Case{0.7, CovarianceForm::kFull, false},
                        {1e-3, CovarianceForm::kFull, false},
                        {0.7, CovarianceForm::kDiagonal, false},
                        {1e-3, CovarianceForm::kDiagonal, false},
                        {0.7, CovarianceForm::kFull, true},
                        {0.7, CovarianceForm::kDiagonal, true}}) {
    const double sigma = c.sigma;
    const CovarianceForm form = c.form;
    const bool adapts = c.adapts;
    constexpr int kP = 5, kLambda = 8;
    std::vector<double> mean = {1, -2, 0.5, 3, -1};
    CmaEs cma(mean, sigma, kLambda, {.covariance = form, .adapt_rates = adapts});
    CmaEsReference reference(Eigen::Map<const Eigen::VectorXd>(mean.data(), kP).cast<long double>(),
                             sigma, kLambda, form == CovarianceForm::kDiagonal, adapts);
    std::vector<double> x(kP * kLambda), costs(kLambda);
    for (int generation = 0; generation < 20; ++generation) {
      INFO("sigma ", sigma, ", form ", static_cast<int>(form), ", adapts ", adapts, ", generation ",
           generation);
      const StreamKey key = SamplingKey(3, generation);
      cma.Ask(key, x);
      const auto factor = reference.Factor();
      std::vector<CmaEsReference::Vector> steps;
      for (int c = 0; c < kLambda; ++c) {
        Eigen::VectorXd z(kP);
        FillNormals(key, static_cast<std::uint32_t>(c), z.data(), kP);
        steps.push_back(factor * z.cast<long double>());
        for (int i = 0; i < kP; ++i) {
          const auto expected =
              static_cast<double>(reference.m[i] + reference.sigma * steps.back()[i]);
          CHECK(std::abs(x[c * kP + i] - expected) < 1e-11);
        }
        costs[c] = Ellipsoid({x.data() + c * kP, kP});
      }
      cma.Tell(costs);
      reference.Update(steps, costs);
      CHECK(cma.sigma() == doctest::Approx(static_cast<double>(reference.sigma)).epsilon(1e-12));
      for (int i = 0; i < kP; ++i) {
        CHECK(std::abs(cma.mean()[i] - static_cast<double>(reference.m[i])) < 1e-11);
      }
    }
  }
}

TEST_CASE("cma_es: needs the known number of evaluations to 1e-8") {
  // Medians that a right implementation needs, by measurement of a reference one.
  CHECK(std::abs(MedianEvaluations(Sphere, 10) / 1460 - 1) < 0.1);
  CHECK(std::abs(MedianEvaluations(Sphere, 20) / 2750 - 1) < 0.1);
  CHECK(std::abs(MedianEvaluations(Ellipsoid, 10) / 4000 - 1) < 0.1);
  CHECK(std::abs(MedianEvaluations(Rosenbrock, 10) / 5650 - 1) < 0.1);
}

TEST_CASE("cma_es: a rising function of the costs changes no bit") {
  const auto run = [](const TestFunction& function) {
    CmaEs cma(std::vector<double>(30, 1.0), 1, 20);
    for (int g = 0; g < 50; ++g) Step(cma, function, 1);
    return std::vector<double>(cma.mean().begin(), cma.mean().end());
  };
  CHECK(run(Ellipsoid) == run([](auto x) { return std::log(Ellipsoid(x)); }));
}

TEST_CASE("cma_es: NaN ranks last") {
  CmaEs cma(std::vector<double>{1, 1}, 1, 6), other = cma;
  std::vector<double> x(12), costs = {3, 1, 2, 4, 5, 6};
  cma.Ask(SamplingKey(0, 0), x);
  other.Ask(SamplingKey(0, 0), x);
  cma.Tell(costs);
  costs[5] = std::numeric_limits<double>::quiet_NaN();
  other.Tell(costs);
  CHECK(cma.mean()[0] == other.mean()[0]);
  CHECK(cma.sigma() == other.sigma());
}

TEST_CASE("cma_es: the smallest populations and one parameter work") {
  for (const int population : {2, 3, 4}) {
    CmaEs cma(std::vector<double>{1.0}, 1, population);
    for (int g = 0; g < 50 && cma.stop().empty(); ++g) Step(cma, Sphere, 1);
    CHECK(std::isfinite(cma.mean()[0]));
    CHECK(std::isfinite(cma.sigma()));
  }
}

TEST_CASE("cma_es: each stopping criterion ends the run that it is for") {
  const CmaEsTolerances off{0, 0, std::numeric_limits<double>::infinity(),
                            std::numeric_limits<double>::infinity()};
  const std::vector<double> ones(5, 1.0);
  CHECK(RunToStop([](auto) { return 1.0; }, ones, 1, {}) == "EqualFunValues");
  CHECK(RunToStop(Sphere, ones, 1, {}) == "TolHistFun");

  CmaEsTolerances tolerances = off;
  tolerances.x = 1e-6;
  CHECK(RunToStop(Sphere, ones, 1, tolerances) == "TolX");
  tolerances = off;
  tolerances.x_up = 1e4;
  CHECK(RunToStop([](auto x) { return x[0]; }, ones, 1, tolerances) == "TolXUp");
  tolerances = off;
  tolerances.condition_cov = 1e4;
  CHECK(RunToStop(Ellipsoid, ones, 1, tolerances) == "ConditionCov");

  // Around 1e8 the doubles are 1.5e-8 apart: the axis comes to no effect before any coordinate.
  const auto far = [](auto x) {
    double sum = 0;
    for (const double v : x) sum += (v - 1e8) * (v - 1e8);
    return sum;
  };
  CHECK(RunToStop(far, std::vector<double>(5, 1e8 + 1), 1, off) == "NoEffectAxis");
  std::vector<double> one_far = ones;
  one_far[2] = 1e17;
  CHECK(RunToStop([](auto x) { return x[0] * x[0]; }, one_far, 1, off) == "NoEffectCoord");

  int call = 0;
  const auto noise = [&](auto) {
    double value;
    FillNormals(SamplingKey(99, call++), 0, &value, 1);
    return value;
  };
  CHECK(RunToStop(noise, ones, 1, off) == "Stagnation");
}

}  // namespace
}  // namespace downpour
