// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/reward.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "kernels/reward/reward_ref.h"
#include "tests/rollout/swing_fixture.h"

namespace downpour {
namespace {

constexpr int kHorizon = 6;
constexpr double kEps = std::numeric_limits<double>::epsilon();

// Some function of one lane of a tile: step, state, features, action.
class LaneReward final : public Reward {
 public:
  using Function = std::function<double(int step, const double* state, const double* features,
                                        const double* action)>;
  LaneReward(Function function, bool in_unit_interval)
      : function_(std::move(function)), in_unit_interval_(in_unit_interval) {}
  std::string Describe() const override { return "a function"; }
  bool InUnitInterval() const override { return in_unit_interval_; }
  void EvaluateTile(int step, const double* states, const double* features, const double* actions,
                    double* rewards) const override {
    for (int lane = 0; lane < kTileLanes; ++lane) {
      rewards[lane] = function_(step, states + lane, features + lane, actions + lane);
    }
  }

 private:
  Function function_;
  bool in_unit_interval_;
};

std::shared_ptr<const Reward> Lanes(LaneReward::Function function, bool in_unit_interval = false) {
  return std::make_shared<LaneReward>(std::move(function), in_unit_interval);
}

std::string ErrorOf(const std::function<void()>& action) {
  try {
    action();
  } catch (const InvalidInput& error) {
    return error.what();
  }
  return "";
}

TEST_CASE("reward: the saturating one describes itself with every number and names its features") {
  const std::vector<Variable> names = {{"speed", "m/s"}, {"cos", "1"}, {"sin", "1"}};
  const auto reward = MakeSaturatingReward(names, {0, 1, 0.5, -1.0 / 3, 0, 0}, {-1, 0}, 0.25);
  CHECK(reward->Describe() ==
        "exp(-d^2 / (2 x 0.25^2)), d^2 = (cos + 0.5 sin + 1)^2 + (-0.3333333333333333 speed)^2");
  CHECK(reward->InUnitInterval());
}

TEST_CASE("reward: sizes that disagree and numbers without sense are refused by name") {
  const std::vector<Variable> names = {{"x", "m"}, {"y", "m"}};
  const auto error = [&](std::vector<double> a, std::vector<double> b, double width) {
    return ErrorOf([&] { MakeSaturatingReward(names, a, b, width); });
  };
  CHECK(error({1, 2, 3}, {0}, 1) == "reward: a has 3 entries: must be 2");
  CHECK(error({1, std::nan("")}, {0}, 1) == "reward: a[1] = nan: must be finite");
  CHECK(error({1, 1}, {HUGE_VAL}, 1) == "reward: b[0] = inf: must be finite");
  for (const double width : {0.0, -1.0, HUGE_VAL}) CHECK(error({1, 1}, {0}, width) != "");
  CHECK(error({1, 1}, {0}, std::nan("")) == "reward: width = nan: must be finite and > 0");
}

TEST_CASE("reward: of one state it is that of the kernel's reference") {
  const Task task = SwingTask(kHorizon);
  const double state[] = {0.4, 2.0}, action[] = {1};
  const double features[] = {0.4, std::cos(2.0), std::sin(2.0)};
  const double a[] = {0, 1, 0, 0, 0, 1}, b[] = {-1, 0};
  const double wanted = static_cast<double>(SaturatingRewardReference(2, 3, a, b, 0.8, features));
  CHECK(std::abs(ComputeReward(task, 3, state, action) - wanted) <= 20 * kEps);
}

TEST_CASE("reward: a black box gives the same returns as the built-in that it copies") {
  Fixture built_in(kHorizon);
  const auto wanted = built_in.Returns(60, 2, {});
  Fixture own(kHorizon);
  own.task.reward = Lanes([](int, const double*, const double* features, const double*) {
    const double c = features[kTileLanes] + 1, s = features[2 * kTileLanes];
    return std::exp(-(c * c + s * s) / (2 * 0.8 * 0.8));
  });
  const auto got = own.Returns(60, 2, {});
  for (std::size_t i = 0; i < got.size(); ++i) {
    CHECK(std::abs(got[i] - wanted[i]) <= 20 * kEps * kHorizon);
  }
}

TEST_CASE("reward: it sees the new state, its features, and the step and action that led there") {
  Fixture f(1);
  f.task.start_std = {0, 0};
  f.task.reward = Lanes([](int, const double* state, const double*, const double* action) {
    return state[0] + 1000 * state[kTileLanes] + 10 * action[0];
  });
  EvaluatorOptions means;
  means.use_variance = false;
  const double got = f.Returns(1, 1, means)[0];
  std::vector<double> theta(f.policy->n_parameters()), features(3), action(1);
  FillNormals({2, 2}, 0, theta.data(), theta.size());
  ComputeFeatures(f.task, f.task.start_mean, features);
  Evaluator evaluator(f.task, *f.policy, f.factors, means);
  const std::vector<double> visited =
      evaluator.Trace(theta, std::vector<StreamKey>{StreamKey{1, 1}}, std::vector<int>{1}).inputs;
  const Eigen::Map<const Eigen::VectorXd> input(visited.data(), 4);
  double state[2];
  for (int e = 0; e < 2; ++e) {
    const GpFactor& gp = std::get<GpFactor>(f.factors[e]);
    AlignedVector<double> x(4 * kTileLanes), mean(kTileLanes);
    for (int d = 0; d < 4; ++d) x[d * kTileLanes] = input[d];
    AlignedVector<char> scratch(GpQueryScratchBytes(gp));
    GpQueryTile(gp, 1, x.data(), scratch.data(), mean.data(), nullptr);
    state[e] = f.task.start_mean[e] + mean[0];
  }
  CHECK(got == doctest::Approx(state[0] + 1000 * state[1] + 10 * visited[3]).epsilon(1e-12));

  f.task.horizon = kHorizon;
  f.task.reward = Lanes(
      [](int step, const double*, const double*, const double*) { return std::ldexp(1.0, step); });
  for (const double sum : f.Returns(3, 1, {})) CHECK(sum == std::ldexp(1.0, kHorizon) - 1);
}

TEST_CASE("reward: a discontinuous one is summed exactly, on any number of threads") {
  Fixture f(40);
  f.task.reward = Lanes([](int, const double* state, const double*, const double*) {
    return state[0] > 0 ? 1.0 : -1.0;
  });
  EvaluatorOptions options;
  const auto one = f.Returns(101, 2, options);
  for (const double sum : one) {
    CHECK(std::abs(sum) <= 40);
    CHECK(std::fmod(sum, 2) == 0);
  }
  CHECK(*std::min_element(one.begin(), one.end()) < *std::max_element(one.begin(), one.end()));
  for (const int threads : {2, 5}) {
    options.threads = threads;
    CHECK(f.Returns(101, 2, options) == one);
  }
}

TEST_CASE("reward: a number that is no reward is divergence, with a penalty below all returns") {
  const double penalty = -(Reward::kLimit + 1) * kHorizon;
  for (const double bad : {std::nan(""), HUGE_VAL, -HUGE_VAL, 1.001e6, -1.001e6}) {
    Fixture f(kHorizon);
    f.task.reward = Lanes([bad](int step, const double* state, const double*, const double*) {
      return step == 2 && state[0] > 0 ? bad : -Reward::kLimit;
    });
    int diverged = 0;
    for (const double sum : f.Returns(64, 1, {})) {
      CHECK((sum == penalty || sum == -Reward::kLimit * kHorizon));
      diverged += sum == penalty;
    }
    CHECK(diverged > 0);
    CHECK(diverged < 64);
    CHECK(f.statistics.diverged == diverged);
  }
}

TEST_CASE(
    "reward: relaxed rollouts take square roots where rewards are in [0, 1], and only there") {
  const auto returns = [](std::vector<double> rewards, bool in_unit_interval) {
    Fixture f(static_cast<int>(rewards.size()));
    f.task.reward = Lanes(
        [rewards](int step, const double*, const double*, const double*) { return rewards[step]; },
        in_unit_interval);
    return f.Returns(1, 1, {}, 0, true)[0];
  };
  CHECK(returns({0.25, 1, 0.0625}, true) == 1.75);
  CHECK(returns({0.25, -1e-17, 0.25}, true) == 1);  // below 0 by rounding
  for (const double bad : {std::nan(""), HUGE_VAL, -HUGE_VAL, 1.001e6, -1.001e6}) {
    CHECK(returns({0.25, bad, 0.25}, true) == -3);
  }
  CHECK(returns({0.25, 4, -1}, false) == 3.25);
}

TEST_CASE("reward: lost causes can only be told where rewards are in [0, 1]") {
  Fixture f(kHorizon);
  f.task.reward = Lanes([](int, const double*, const double*, const double*) { return 0.5; });
  Evaluator evaluator(f.task, *f.policy, f.factors, {});
  std::vector<double> theta(2 * f.policy->n_parameters()), returns(2);
  const std::vector<StreamKey> keys(2);
  const std::vector<int> one(2, 1), zero(2, 0);
  CHECK_NOTHROW(evaluator.Evaluate(theta, keys, one, zero, returns));
  const std::vector<CandidateGroup> groups = {{2, 1}};
  CHECK(ErrorOf([&] { evaluator.Evaluate(theta, keys, one, zero, returns, groups); }) ==
        "evaluator: candidate groups: rewards must be in [0, 1], and those of this task, or learnt "
        "ones, may not be");
}

}  // namespace
}  // namespace downpour
