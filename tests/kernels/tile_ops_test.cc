// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "kernels/features/features.h"
#include "kernels/features/features_ref.h"
#include "kernels/mlp/mlp.h"
#include "kernels/mlp/mlp_ref.h"
#include "kernels/reward/reward.h"
#include "kernels/reward/reward_ref.h"
#include "kernels/transition/transition.h"
#include "kernels/transition/transition_ref.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

AlignedVector<double> RandomTile(int rows, double scale, TestNumbers& random) {
  AlignedVector<double> tile(rows * kTileLanes);
  for (double& x : tile) x = scale * random();
  return tile;
}

std::vector<double> Column(const AlignedVector<double>& tile, int lane) {
  std::vector<double> column(tile.size() / kTileLanes);
  for (std::size_t r = 0; r < column.size(); ++r) column[r] = tile[r * kTileLanes + lane];
  return column;
}

TEST_CASE("features: match the long-double twin to 3 ulp on every target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(1);
    const Feature map[] = {{FeatureKind::kIdentity, 1},
                           {FeatureKind::kCosine, 0},
                           {FeatureKind::kSine, 0},
                           {FeatureKind::kSine, 1}};
    for (const double scale : {1e-3, 3.0, 50.0, 30000.0}) {
      const auto states = RandomTile(2, scale, random);
      AlignedVector<double> features(4 * kTileLanes);
      FeatureTile(map, 4, states.data(), features.data());
      for (int lane = 0; lane < kTileLanes; ++lane) {
        for (int f = 0; f < 4; ++f) {
          const double got = features[f * kTileLanes + lane];
          const long double want =
              FeatureReference(map[f].kind, states[map[f].state_index * kTileLanes + lane]);
          // Near a zero of sine or cosine the argument reduction leaves an absolute error.
          CHECK(std::abs(got - want) <= 3 * kEps * std::abs(want) + scale * kEps * kEps);
        }
      }
    }
  });
}

TEST_CASE("mlp: matches the long-double twin for every shape and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(2);
    for (const MlpShape shape :
         {MlpShape{1, 1, 1}, MlpShape{5, 10, 1}, MlpShape{8, 10, 4}, MlpShape{3, 33, 2}}) {
      const auto parameters = RandomTile(shape.n_parameters(), 2, random);
      const auto inputs = RandomTile(shape.n_inputs, 3, random);
      std::vector<double> scale(shape.n_inputs), limits(shape.n_outputs);
      for (double& s : scale) s = 0.6 + 0.4 * random();
      for (double& l : limits) l = 5 + random();
      AlignedVector<double> outputs(shape.n_outputs * kTileLanes);
      MlpTile(shape, parameters.data(), scale.data(), limits.data(), inputs.data(), outputs.data());
      for (int lane = 0; lane < kTileLanes; ++lane) {
        const auto theta = Column(parameters, lane);
        const auto want = MlpReference(shape, theta.data(), scale.data(), limits.data(),
                                       Column(inputs, lane).data());
        for (int o = 0; o < shape.n_outputs; ++o) {
          // Weights <= 2, scaled inputs <= 3: each hidden pre-activation sums F + 1 terms <= 6,
          // its error reaches the output through a weight <= 2, with tanh within 5 ulp.
          const double hidden = (shape.n_inputs + 2) * 6.0 * (shape.n_inputs + 1) + 5;
          const double bound = (shape.n_hidden + 1) * 2 * (hidden + shape.n_hidden + 2) + 8;
          CHECK(std::abs(outputs[o * kTileLanes + lane] - want[o]) <= limits[o] * bound * kEps);
          CHECK(std::abs(outputs[o * kTileLanes + lane]) <= limits[o]);
        }
      }
    }
  });
}

TEST_CASE("mlp: a saturated network keeps the limit exactly") {
  const MlpShape shape{1, 1, 1};
  AlignedVector<double> parameters(4 * kTileLanes, 1e3), inputs(kTileLanes, 1e3);
  AlignedVector<double> outputs(kTileLanes);
  const double scale = 1, limit = 10;
  ForEachTarget([&](const char* target) {
    CAPTURE(target);
    MlpTile(shape, parameters.data(), &scale, &limit, inputs.data(), outputs.data());
    for (const double u : outputs) CHECK(u == limit);
  });
}

TEST_CASE("reward: matches the long-double twin on every target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(3);
    for (const int rows : {1, 2, 3}) {
      const int n = 5;
      std::vector<double> a(rows * n), b(rows);
      for (double& x : a) x = random();
      for (double& x : b) x = random();
      const auto features = RandomTile(n, 1, random);
      AlignedVector<double> rewards(kTileLanes);
      SaturatingRewardTile(rows, n, a.data(), b.data(), 0.25, features.data(), rewards.data());
      for (int lane = 0; lane < kTileLanes; ++lane) {
        const long double want = SaturatingRewardReference(rows, n, a.data(), b.data(), 0.25,
                                                           Column(features, lane).data());
        // |y_r| <= F + 1 with F + 1 roundings each; the exponent's error is relative in exp.
        const double exponent_error = 8 * rows * (n + 1) * (n + 2) * (n + 3) * kEps;
        CHECK(std::abs(rewards[lane] - want) <= want * (exponent_error + 2 * kEps));
      }
    }
  });
}

TEST_CASE("transition: matches the long-double twin, clamps samples and retires lanes") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    TestNumbers random(4);
    for (const double clamp : {0.0, 1.0}) {
      auto state = RandomTile(1, 3, random);
      const auto before = state;
      auto mean = RandomTile(1, 1, random), variance = RandomTile(1, 1, random);
      const auto z = RandomTile(1, 4, random);
      for (double& v : variance) v = std::abs(v);
      mean[3] = std::nan("");
      mean[4] = 1e9;
      mean[5] = -std::numeric_limits<double>::infinity();
      AlignedVector<double> alive(kTileLanes, 1.0);
      alive[6] = 0;
      TransitionTile(mean.data(), variance.data(), 0.01, z.data(), clamp, 100, state.data(),
                     alive.data());
      for (int lane = 0; lane < kTileLanes; ++lane) {
        if (lane >= 3 && lane <= 5) {
          CHECK(state[lane] == 0);
          CHECK(alive[lane] == 0);
          continue;
        }
        CHECK(alive[lane] == (lane == 6 ? 0 : 1));
        const long double want =
            TransitionReference(before[lane], mean[lane], variance[lane], 0.01, z[lane], clamp);
        CHECK(std::abs(state[lane] - want) <= 4 * kEps * (3 + 1 + 4 * 1.01));
      }
    }
  });
}

TEST_CASE("transition: without variance the state moves by the mean alone") {
  AlignedVector<double> state(kTileLanes, 1.0), mean(kTileLanes, 0.5), alive(kTileLanes, 1.0);
  TransitionTile(mean.data(), nullptr, 9.0, nullptr, 0, 100, state.data(), alive.data());
  for (const double x : state) CHECK(x == 1.5);
}

}  // namespace
}  // namespace downpour
