// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/random_start.h"

#include <doctest/doctest.h>

#include <cmath>

#include "engine/errors.h"

namespace downpour {
namespace {

// An angle and its velocity, two actions.
Task AngleTask() {
  Task task;
  task.states = {{"velocity", "rad/s"}, {"angle", "rad"}};
  task.features = {{FeatureKind::kIdentity, 0}, {FeatureKind::kCosine, 1}, {FeatureKind::kSine, 1}};
  task.feature_names = {{"velocity", "rad/s"}, {"cos", "1"}, {"sin", "1"}};
  task.actions = {{"a", "N"}, {"b", "N"}};
  task.action_limits = {1, 2};
  task.start_mean = {4, 2};
  task.start_std = {0.5, 0.1};
  task.policy_input_scale = {10, 1, 2};
  task.policy_points = 200;
  return task;
}

TEST_CASE("PILCO's start, gp: pseudo-inputs are features of start states, targets are small") {
  const Task task = AngleTask();
  const int n = 200;
  const PolicyOptions options{.kind = PolicyKind::kGp};
  const std::vector<double> p = DrawPilcoStart(task, options, {1, 2});
  REQUIRE(static_cast<int>(p.size()) == MakePolicy(task, options)->n_parameters());
  double mean = 0, square = 0, target_square = 0;
  for (int i = 0; i < n; ++i) {
    const double velocity = 10 * p[3 * i], cosine = p[3 * i + 1], sine = 2 * p[3 * i + 2];
    CHECK(cosine * cosine + sine * sine == doctest::Approx(1));
    CHECK(std::abs(std::atan2(sine, cosine) - 2) < 8.5 * 0.1);
    mean += velocity / n;
    square += std::pow((velocity - 4) / 0.5, 2) / n;
  }
  for (int i = 0; i < 2 * n; ++i) target_square += std::pow(p[3 * n + i] / 0.1, 2) / (2 * n);
  // Five standard errors: of a mean, of mean squares.
  CHECK(std::abs(mean - 4) < 5 * 0.5 / std::sqrt(n));
  CHECK(std::abs(square - 1) < 5 * std::sqrt(2.0 / n));
  CHECK(std::abs(target_square - 1) < 5 * std::sqrt(2.0 / (2 * n)));
  for (int a = 0; a < 2; ++a) {
    const double* const log_lengthscales = &p[5 * n + 3 * a];
    CHECK(log_lengthscales[0] == doctest::Approx(std::log(0.1)));
    CHECK(log_lengthscales[1] == doctest::Approx(std::log(0.7)));
    CHECK(log_lengthscales[2] == doctest::Approx(std::log(0.35)));
  }
}

TEST_CASE("PILCO's start, linear: small weights, no bias; another key gives others") {
  const Task task = AngleTask();
  const PolicyOptions options{.kind = PolicyKind::kLinear};
  const std::vector<double> p = DrawPilcoStart(task, options, {1, 2});
  REQUIRE(p.size() == 8);
  for (int i = 0; i < 6; ++i) CHECK((p[i] != 0 && std::abs(p[i]) < 0.85));
  CHECK((p[6] == 0 && p[7] == 0));
  CHECK(DrawPilcoStart(task, options, {1, 2}) == p);
  CHECK(DrawPilcoStart(task, options, {1, 3}) != p);
  CHECK_THROWS_AS(DrawPilcoStart(task, {}, {1, 2}), InvalidInput);
}

}  // namespace
}  // namespace downpour
