// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "kernels/gp_policy/gp_policy.h"
#include "kernels/gp_policy/gp_policy_ref.h"
#include "kernels/linear_policy/linear_policy.h"
#include "kernels/linear_policy/linear_policy_ref.h"
#include "kernels/mlp/mlp.h"
#include "kernels/mlp/mlp_ref.h"
#include "kernels/movement_primitive/movement_primitive.h"
#include "kernels/movement_primitive/movement_primitive_ref.h"
#include "tests/kernels/each_target.h"
#include "tests/kernels/random_tile.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();
// kappa's slope is 1.5 at most, its own error 6 eps.
constexpr double kSquashSlope = 1.5, kSquashError = 6 * kEps;

// `n` numbers in [0.5, 1.5) times `scale`.
std::vector<double> Positive(int n, double scale, TestNumbers& random) {
  std::vector<double> numbers(n);
  for (double& x : numbers) x = scale * (1 + 0.5 * random());
  return numbers;
}

std::vector<double> Mlp(const MlpShape& shape, const AlignedVector<double>& parameters,
                        const std::vector<double>& scale, const std::vector<double>& limits,
                        const AlignedVector<double>& inputs) {
  AlignedVector<double> scratch(shape.scratch_rows() * kTileLanes, std::nan(""));
  AlignedVector<double> outputs(shape.n_outputs() * kTileLanes);
  MlpTile(shape, kTileLanes, parameters.data(), scale.data(), limits.data(), inputs.data(),
          scratch.data(), outputs.data());
  return {outputs.begin(), outputs.end()};
}

TEST_CASE("mlp: matches the long-double twin for every depth, width, activation and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(2);
    const std::vector<std::vector<int>> layers = {
        {1, 1, 1}, {5, 10, 1}, {8, 10, 4}, {3, 33, 2}, {2, 1}, {5, 16, 16, 1}, {3, 2, 7, 5, 2}};
    for (const std::vector<int>& units : layers) {
      for (const Activation activation : {Activation::kTanh, Activation::kRelu}) {
        const MlpShape shape{units, activation};
        const auto parameters = RandomTile(shape.n_parameters(), 2, random);
        const auto inputs = RandomTile(shape.n_inputs(), 3, random);
        const auto scale = Positive(shape.n_inputs(), 0.6, random);
        const auto limits = Positive(shape.n_outputs(), 5, random);
        const auto outputs = Mlp(shape, parameters, scale, limits, inputs);
        // |y| <= m with an error of e: a unit of the next layer sums fan-in + 1 terms of at most
        // 2 m, each rounded as often, and tanh is within 5 ulp.
        double m = 3, e = 3 * kEps;
        for (std::size_t l = 1; l < units.size(); ++l) {
          const double sum = 2 * m * (units[l - 1] + 1);
          e = 2 * units[l - 1] * e + (units[l - 1] + 2) * sum * kEps + 5 * kEps;
          m = activation == Activation::kTanh ? 1 : sum;
        }
        for (int lane = 0; lane < kTileLanes; ++lane) {
          const auto want = MlpReference(shape, Column(parameters, lane).data(), scale.data(),
                                         limits.data(), Column(inputs, lane).data());
          for (int o = 0; o < shape.n_outputs(); ++o) {
            const double got = outputs[o * kTileLanes + lane];
            CHECK(std::abs(got - want[o]) <= limits[o] * (e + 2 * kEps));
            CHECK(std::abs(got) <= limits[o]);
          }
        }
      }
    }
  });
}

TEST_CASE("mlp: a saturated network keeps the limit exactly") {
  const MlpShape shape{{1, 1, 1}};
  const AlignedVector<double> parameters(4 * kTileLanes, 1e3), inputs(kTileLanes, 1e3);
  ForEachTarget([&](const char* target) {
    CAPTURE(target);
    for (const double u : Mlp(shape, parameters, {1}, {10}, inputs)) CHECK(u == 10);
  });
}

TEST_CASE("linear policy: matches the long-double twin for every shape and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(3);
    for (const LinearPolicyShape shape :
         {LinearPolicyShape{1, 1}, LinearPolicyShape{5, 1}, LinearPolicyShape{8, 4}}) {
      const auto parameters = RandomTile(shape.n_parameters(), 5, random);
      const auto inputs = RandomTile(shape.n_inputs, 3, random);
      const auto scale = Positive(shape.n_inputs, 0.6, random);
      const auto limits = Positive(shape.n_outputs, 5, random);
      AlignedVector<double> outputs(shape.n_outputs * kTileLanes);
      LinearPolicyTile(shape, kTileLanes, parameters.data(), scale.data(), limits.data(),
                       inputs.data(), outputs.data());
      const double sum = 5 * 3 * (shape.n_inputs + 1);
      const double error = kSquashSlope * (shape.n_inputs + 2) * sum * kEps + kSquashError;
      for (int lane = 0; lane < kTileLanes; ++lane) {
        const auto want =
            LinearPolicyReference(shape, Column(parameters, lane).data(), scale.data(),
                                  limits.data(), Column(inputs, lane).data());
        for (int o = 0; o < shape.n_outputs; ++o) {
          const double got = outputs[o * kTileLanes + lane];
          CHECK(std::abs(got - want[o]) <= limits[o] * error);
          CHECK(std::abs(got) <= limits[o]);
        }
      }
    }
  });
}

TEST_CASE("linear policy: keeps the limit at the peaks of kappa and far beyond its range") {
  const LinearPolicyShape shape{1, 1};
  AlignedVector<double> parameters(2 * kTileLanes), inputs(kTileLanes, 0.0), outputs(kTileLanes);
  const double one = 1, limit = 10;
  const double peak = std::acos(-1) / 2;
  for (int lane = 0; lane < kTileLanes; ++lane) {
    const double around = std::nextafter(peak, 3) + (lane - 16) * 1e-9;
    parameters[kTileLanes + lane] = lane < 32 ? around : (lane - 39.5) * 1e300;
  }
  ForEachTarget([&](const char* target) {
    CAPTURE(target);
    LinearPolicyTile(shape, kTileLanes, parameters.data(), &one, &limit, inputs.data(),
                     outputs.data());
    for (int lane = 0; lane < kTileLanes; ++lane) {
      CHECK(std::abs(outputs[lane]) <= limit);
      const double bias = parameters[kTileLanes + lane];
      const double want = limit * static_cast<double>(SquashReference(bias));
      CHECK(std::abs(outputs[lane] - want) <= limit * kSquashError);
    }
  });
}

TEST_CASE("movement primitive: matches the long-double twin for every shape and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(4);
    for (const int n_weights : {2, 11, 21}) {
      for (const int n_outputs : {1, 3}) {
        const auto parameters = RandomTile(n_weights * n_outputs, 5, random);
        const auto response = Positive(n_weights, 0.2, random);
        const auto limits = Positive(n_outputs, 5, random);
        AlignedVector<double> outputs(n_outputs * kTileLanes);
        MovementPrimitiveTile(n_weights, n_outputs, kTileLanes, response.data(), parameters.data(),
                              limits.data(), outputs.data());
        const double error = kSquashSlope * n_weights * (n_weights * 5 * 0.3) * kEps + kSquashError;
        for (int lane = 0; lane < kTileLanes; ++lane) {
          const auto want =
              MovementPrimitiveReference(n_weights, n_outputs, response.data(),
                                         Column(parameters, lane).data(), limits.data());
          for (int o = 0; o < n_outputs; ++o) {
            CHECK(std::abs(outputs[o * kTileLanes + lane] - want[o]) <= limits[o] * error);
          }
        }
      }
    }
  });
}

AlignedVector<double> Gp(const GpPolicyShape& shape, const AlignedVector<double>& parameters,
                         const std::vector<double>& scale, const std::vector<double>& limits,
                         const AlignedVector<double>& inputs) {
  AlignedVector<double> scratch(shape.scratch_rows() * kTileLanes, std::nan(""));
  AlignedVector<double> outputs(shape.n_outputs * kTileLanes), again(outputs.size());
  GpPolicyPrepareTile(shape, kTileLanes, parameters.data(), scratch.data());
  GpPolicyTile(shape, kTileLanes, scale.data(), limits.data(), inputs.data(), scratch.data(),
               outputs.data());
  GpPolicyTile(shape, kTileLanes, scale.data(), limits.data(), inputs.data(), scratch.data(),
               again.data());
  CHECK(outputs == again);  // a step leaves what was prepared
  return outputs;
}

// Bound of |output - reference| / limit. Coordinates in length-scales are at most `reach`, so a
// covariance is within kernel_error; the factor L of K + 0.01 I satisfies L L^T = K + 0.01 I + E
// with |E| <= n (n + 2) eps + n kernel_error; |(K + 0.01 I)^-1 k| <= 10, as k^T (K + 0.01 I)^-1 k
// <= 1 and no eigenvalue is below 0.01.
double GpBound(const GpPolicyShape& shape, double reach, double alpha_norm) {
  const int n = shape.n_points, dim = shape.n_inputs;
  const double kernel_error = kEps * (4 * dim * reach + 2 * dim + 8);
  const double factor_error = n * (n + 2) * kEps + n * kernel_error;
  const double sum_error = std::sqrt(n) * ((n + 2) * kEps + kernel_error);
  return kSquashSlope * alpha_norm * (3 * 10 * factor_error + sum_error) + kSquashError;
}

TEST_CASE("gp policy: matches the long-double twin for every shape and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(5);
    for (const GpPolicyShape shape : {GpPolicyShape{1, 1, 1}, GpPolicyShape{3, 10, 1},
                                      GpPolicyShape{5, 20, 1}, GpPolicyShape{8, 7, 4}}) {
      const auto parameters = RandomTile(shape.n_parameters(), 1.5, random);
      const auto inputs = RandomTile(shape.n_inputs, 2, random);
      const auto scale = Positive(shape.n_inputs, 0.6, random);
      const auto limits = Positive(shape.n_outputs, 5, random);
      const auto outputs = Gp(shape, parameters, scale, limits, inputs);
      for (int lane = 0; lane < kTileLanes; ++lane) {
        const auto want = ReferenceGpPolicy(shape, Column(parameters, lane).data(), scale.data(),
                                            limits.data(), Column(inputs, lane).data());
        for (int o = 0; o < shape.n_outputs; ++o) {
          const double bound =
              GpBound(shape, 1.8 * std::exp(1.5), static_cast<double>(want.alpha_norm[o]));
          const double got = outputs[o * kTileLanes + lane];
          CHECK(std::abs(got - want.output[o]) <= limits[o] * bound);
          CHECK(std::abs(got) <= limits[o]);
        }
      }
    }
  });
}

TEST_CASE("gp policy: pseudo-inputs that coincide, and extreme length-scales, stay finite") {
  const GpPolicyShape shape{2, 12, 1};
  TestNumbers random(6);
  auto parameters = RandomTile(shape.n_parameters(), 3, random);
  std::fill_n(parameters.begin(), 2 * 12 * kTileLanes, 0.5);  // all pseudo-inputs
  const auto inputs = RandomTile(2, 2, random);
  ForEachTarget([&](const char* target) {
    CAPTURE(target);
    const auto outputs = Gp(shape, parameters, {1, 1}, {2}, inputs);
    for (int lane = 0; lane < kTileLanes; ++lane) {
      const auto want = ReferenceGpPolicy(
          shape, Column(parameters, lane).data(), std::vector<double>{1, 1}.data(),
          std::vector<double>{2}.data(), Column(inputs, lane).data());
      const double bound =
          GpBound(shape, 2.5 * std::exp(3), static_cast<double>(want.alpha_norm[0]));
      CHECK(std::abs(outputs[lane] - want.output[0]) <= 2 * bound);
    }
    auto extreme = parameters;
    for (int i = 0; i < 2 * kTileLanes; ++i) {
      extreme[(2 * 12 + 12) * kTileLanes + i] = i % 2 == 0 ? 1e6 : -1e6;
    }
    for (const double u : Gp(shape, extreme, {1, 1}, {2}, inputs)) CHECK(std::abs(u) <= 2);
  });
}

}  // namespace
}  // namespace downpour
