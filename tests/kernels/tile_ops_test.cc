// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "kernels/features/features.h"
#include "kernels/features/features_ref.h"
#include "kernels/reward/reward.h"
#include "kernels/reward/reward_ref.h"
#include "kernels/transition/transition.h"
#include "kernels/transition/transition_ref.h"
#include "tests/kernels/each_target.h"
#include "tests/kernels/random_tile.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

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
