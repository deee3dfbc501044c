// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "engine/errors.h"
#include "kernels/features/features_ref.h"
#include "kernels/gp_query/gp_query_ref.h"
#include "kernels/philox/philox_ref.h"
#include "kernels/transition/transition_ref.h"
#include "tests/rollout/swing_fixture.h"

namespace downpour {
namespace {

// The swing's model with a GP of a reward on the three features, wide of [0, 1].
Fixture LearntReward(int horizon, QueryBackend backend = QueryBackend::kFused) {
  Fixture f(horizon, 30, backend);
  Eigen::MatrixXd inputs(25, 3);
  Eigen::VectorXd targets(25);
  std::vector<double> u(50);
  FillUniforms({4, 4}, 0, u.data(), u.size());
  for (int i = 0; i < 25; ++i) {
    const double v = 4 * u[2 * i] - 2, angle = 6 * u[2 * i + 1] - 3;
    inputs.row(i) << v, std::cos(angle), std::sin(angle);
    targets[i] = 3 * std::sin(angle) - v;
  }
  const ExactGp gp(inputs, targets, {{3, 1, 1}, 2, 0.3});
  if (backend == QueryBackend::kBlas) {
    f.factors.push_back(MakeBlasFactor(gp));
  } else {
    f.factors.push_back(gp.Pack());
  }
  f.task.reward = nullptr;  // unknown
  return f;
}

// One rollout with a policy of zeros, whose action is 0, by the scalar twins.
double ReferenceReturn(const Fixture& f, StreamKey key, std::uint32_t rollout,
                       const EvaluatorOptions& options, double start_shift, bool relaxed) {
  const Task& task = f.task;
  const auto z0 = NormalPairReference({0, 0xFFFFFFFF, rollout, 0}, key);
  double state[2], x[4];
  for (int e = 0; e < 2; ++e) {
    state[e] = task.start_mean[e] + task.start_std[e] * static_cast<double>(z0[e]) + start_shift;
  }
  const auto features = [&] {
    for (int k = 0; k < 3; ++k) {
      x[k] = FeatureReference(task.features[k].kind, state[task.features[k].state_index]);
    }
    x[3] = 0;
  };
  const auto sample = [&](double from, int output, long double z) {
    const GpFactor& factor = std::get<GpFactor>(f.factors[output]);
    const GpQueryReference q = QueryReference(factor, x);
    if (!options.use_variance) return from + static_cast<double>(q.mean);
    return static_cast<double>(TransitionReference(
        from, q.mean, std::max(q.variance, 0.0L), options.predict_noise ? factor.noise_variance : 0,
        relaxed ? z / 2 : z, options.sample_clamp));
  };
  double sum = 0;
  for (std::uint32_t step = 0; step < static_cast<std::uint32_t>(task.horizon); ++step) {
    // Variables 0 and 1 are the states' block of the stream, 2 is the first of the next block.
    const auto z = NormalPairReference({0, step, rollout, 0}, key);
    const auto z_reward = NormalPairReference({1, step, rollout, 0}, key);
    features();
    double next[2];
    for (int e = 0; e < 2; ++e) next[e] = sample(state[e], e, z[e]);
    state[0] = next[0];
    state[1] = next[1];
    features();
    sum += sample(0, 2, z_reward[0]);
  }
  return sum;
}

// n rollouts of the policy of zeros.
std::vector<double> Returns(const Fixture& f, int n, const EvaluatorOptions& options,
                            EvaluatorStatistics* statistics = nullptr, bool relaxed = false) {
  Evaluator evaluator(f.task, *f.policy, f.factors, options);
  const std::vector<double> theta(f.policy->n_parameters(), 0.0);
  const std::vector<StreamKey> keys = {{3, 9}};
  std::vector<double> returns(n);
  evaluator.Evaluate(theta, keys, std::vector<int>{n}, std::vector<int>{0}, returns, {}, relaxed);
  if (statistics != nullptr) *statistics = evaluator.statistics();
  return returns;
}

void CheckReturns(const EvaluatorOptions& options, bool relaxed) {
  const int n = 30;
  const Fixture f = LearntReward(6);
  const auto got = Returns(f, n, options, nullptr, relaxed);
  for (std::uint32_t r = 0; r < n; ++r) {
    const double want = ReferenceReturn(f, {3, 9}, r, options, 0, relaxed);
    // Rounding in a state grows as a shift of the start does: measure that growth.
    const double shift = 1e-7;
    const double growth =
        std::abs(ReferenceReturn(f, {3, 9}, r, options, shift, relaxed) - want) / shift;
    const double tolerance =
        1000 * f.task.horizon * std::numeric_limits<double>::epsilon() * (1 + growth);
    CHECK(std::abs(got[r] - want) <= tolerance);
  }
}

TEST_CASE("learnt reward: returns match a scalar rollout that samples it, for every option") {
  EvaluatorOptions all, no_variance, clamped, no_noise;
  no_variance.use_variance = false;
  clamped.sample_clamp = 1;
  no_noise.predict_noise = false;
  for (const EvaluatorOptions& options : {all, no_variance, clamped, no_noise}) {
    for (const bool relaxed : {false, true}) CheckReturns(options, relaxed);
  }
}

TEST_CASE("learnt reward: states are sampled as without it") {
  const Fixture with = LearntReward(6);
  Fixture without(6);
  const std::vector<double> theta(with.policy->n_parameters(), 0.0);
  const std::vector<StreamKey> keys = {{3, 9}};
  Evaluator a(with.task, *with.policy, with.factors, {});
  Evaluator b(without.task, *without.policy, without.factors, {});
  const std::vector<int> one(keys.size(), 1);
  CHECK(a.Trace(theta, keys, one).inputs == b.Trace(theta, keys, one).inputs);
}

TEST_CASE("learnt reward: bits do not depend on threads, its queries count, groups are refused") {
  const Fixture f = LearntReward(40);
  EvaluatorOptions options;
  EvaluatorStatistics statistics;
  const auto one = Returns(f, 150, options, &statistics);
  CHECK(statistics.gp_queries == 150 * 40 * 3);
  for (const int threads : {2, 5}) {
    options.threads = threads;
    CHECK(Returns(f, 150, options) == one);
  }
  Evaluator evaluator(f.task, *f.policy, f.factors, {});
  const std::vector<double> theta(2 * f.policy->n_parameters());
  std::vector<double> returns(2);
  const std::vector<int> ones(2, 1), zeros(2, 0);
  const std::vector<CandidateGroup> groups = {{2, 1}};
  CHECK_THROWS_AS(
      evaluator.Evaluate(theta, std::vector<StreamKey>(2), ones, zeros, returns, groups),
      InvalidInput);
}

TEST_CASE("learnt reward: OpenBLAS gives the fused kernel's returns to rounding") {
  const Fixture fused = LearntReward(6), blas = LearntReward(6, QueryBackend::kBlas);
  const auto want = Returns(fused, 300, {}), got = Returns(blas, 300, {});
  for (std::size_t i = 0; i < got.size(); ++i) {
    CHECK(std::abs(got[i] - want[i]) <= 1e-9 * (1 + std::abs(want[i])));
  }
}

TEST_CASE("learnt reward: a factor on other inputs than the features is refused") {
  Fixture f = LearntReward(6);
  f.factors[2] = f.factors[0];  // of features and action
  CHECK_THROWS_AS(Evaluator(f.task, *f.policy, f.factors, {}), InvalidInput);
  f.factors.pop_back();  // neither known nor learnt
  CHECK_THROWS_AS(Evaluator(f.task, *f.policy, f.factors, {}), InvalidInput);
}

}  // namespace
}  // namespace downpour
