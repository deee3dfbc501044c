// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/evaluator.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <new>
#include <numeric>
#include <vector>

#include "engine/errors.h"
#include "engine/gp/gp_model.h"
#include "kernels/features/features_ref.h"
#include "kernels/gp_query/gp_query_ref.h"
#include "kernels/mlp/mlp_ref.h"
#include "kernels/philox/philox_ref.h"
#include "kernels/reward/reward_ref.h"
#include "kernels/transition/transition_ref.h"
#include "tests/rollout/swing_fixture.h"

namespace {
std::atomic<long> allocations{0};
}

// Counts heap allocations of this test program.
// Not inlined, so that the compiler sees no free() of what a library's new gave.
[[gnu::noinline]] void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size)) return p;
  throw std::bad_alloc();
}
[[gnu::noinline]] void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  ++allocations;
  return std::malloc(size);
}
[[gnu::noinline]] void* operator new(std::size_t size, std::align_val_t alignment) {
  ++allocations;
  const std::size_t a = static_cast<std::size_t>(alignment);
  if (void* p = std::aligned_alloc(a, (size + a - 1) / a * a)) return p;
  throw std::bad_alloc();
}
[[gnu::noinline]] void operator delete(void* p) noexcept { std::free(p); }
[[gnu::noinline]] void operator delete(void* p, std::size_t) noexcept { std::free(p); }
[[gnu::noinline]] void operator delete(void* p, std::align_val_t) noexcept { std::free(p); }
[[gnu::noinline]] void operator delete(void* p, std::size_t, std::align_val_t) noexcept {
  std::free(p);
}

namespace downpour {
namespace {

// The return of one rollout by the scalar twins, one lane, in long double where they allow.
double ReferenceReturn(const Fixture& f, const double* theta, StreamKey key, std::uint32_t rollout,
                       const EvaluatorOptions& options, double start_shift, bool relaxed) {
  const Task& task = f.task;
  const MlpShape shape{{3, 4, 1}};
  std::vector<double> input_scale;
  for (const double s : task.policy_input_scale) input_scale.push_back(1 / s);
  const auto z0 = NormalPairReference({0, 0xFFFFFFFF, rollout, 0}, key);
  std::array<double, 2> state;
  for (int e = 0; e < 2; ++e) {
    state[e] = task.start_mean[e] + task.start_std[e] * static_cast<double>(z0[e]) + start_shift;
  }
  long double sum = 0;
  for (std::uint32_t step = 0; step < static_cast<std::uint32_t>(task.horizon); ++step) {
    double x[4];
    for (int k = 0; k < 3; ++k) {
      x[k] = FeatureReference(task.features[k].kind, state[task.features[k].state_index]);
    }
    x[3] = MlpReference(shape, theta, input_scale.data(), task.action_limits.data(), x)[0];
    const auto z = NormalPairReference({0, step, rollout, 0}, key);
    for (int e = 0; e < 2; ++e) {
      const GpQueryReference q = QueryReference(std::get<GpFactor>(f.factors[e]), x);
      if (options.use_variance) {
        state[e] = TransitionReference(
            state[e], q.mean, std::max(q.variance, 0.0L),
            options.predict_noise ? std::get<GpFactor>(f.factors[e]).noise_variance : 0,
            relaxed ? z[e] / 2 : z[e], options.sample_clamp);
      } else {
        state[e] += static_cast<double>(q.mean);
      }
    }
    for (int k = 0; k < 3; ++k) {
      x[k] = FeatureReference(task.features[k].kind, state[task.features[k].state_index]);
    }
    constexpr double kA[] = {0, 1, 0, 0, 0, 1}, kB[] = {-1, 0};  // as SwingTask has them
    const auto reward = SaturatingRewardReference(2, 3, kA, kB, 0.8, x);
    sum += relaxed ? std::sqrt(reward) : reward;
  }
  return static_cast<double>(sum);
}

void CheckReturns(const EvaluatorOptions& options, bool relaxed) {
  Fixture f;
  const int n = 17, r = 3;
  const auto got = f.Returns(n, r, options, 0, relaxed);
  std::vector<double> theta(n * f.policy->n_parameters());
  FillNormals({2, 2}, 0, theta.data(), theta.size());
  for (std::uint32_t c = 0; c < n; ++c) {
    const StreamKey key = DeriveKey(7, StreamPurpose::kRollout, {c});
    for (std::uint32_t k = 0; k < r; ++k) {
      const double* row = &theta[c * f.policy->n_parameters()];
      const double want = ReferenceReturn(f, row, key, k, options, 0, relaxed);
      // Rounding in a state grows as a shift of the start does: measure that growth.
      const double shift = 1e-7;
      const double growth =
          std::abs(ReferenceReturn(f, row, key, k, options, shift, relaxed) - want) / shift;
      const double tolerance =
          1000 * f.task.horizon * std::numeric_limits<double>::epsilon() * (1 + growth);
      CHECK(std::abs(got[c * r + k] - want) <= tolerance);
    }
  }
}

TEST_CASE("evaluator: returns match a scalar rollout for every option") {
  EvaluatorOptions all;
  EvaluatorOptions no_variance;
  no_variance.use_variance = false;
  EvaluatorOptions clamped;
  clamped.sample_clamp = 1;
  EvaluatorOptions no_noise;
  no_noise.predict_noise = false;
  for (const EvaluatorOptions& options : {all, no_variance, clamped, no_noise}) {
    for (const bool relaxed : {false, true}) CheckReturns(options, relaxed);
  }
}

TEST_CASE("evaluator: the bits do not depend on the number of threads") {
  Fixture f(40);
  EvaluatorOptions options;
  const auto one = f.Returns(101, 2, options);
  for (const int threads : {2, 5}) {
    options.threads = threads;
    CHECK(f.Returns(101, 2, options) == one);
  }
}

TEST_CASE("evaluator: the bits do not depend on how rollouts are packed") {
  Fixture f(40);
  const auto together = f.Returns(30, 4, {});
  const auto first_half = f.Returns(30, 2, {});
  const auto second_half = f.Returns(30, 2, {}, 2);
  for (int c = 0; c < 30; ++c) {
    for (int r = 0; r < 2; ++r) {
      CHECK(together[4 * c + r] == first_half[2 * c + r]);
      CHECK(together[4 * c + 2 + r] == second_half[2 * c + r]);
    }
  }
  const auto few = f.Returns(1, 4, {});
  for (int r = 0; r < 4; ++r) CHECK(few[r] == together[r]);
}

TEST_CASE("evaluator: rollouts of one candidate differ, and so do candidates with equal policies") {
  Fixture f;
  Evaluator evaluator(f.task, *f.policy, f.factors, {});
  const int n = 2, r = 50;
  std::vector<double> theta(n * f.policy->n_parameters(), 0.1), returns(n * r);
  const std::vector<StreamKey> keys = {{1, 1}, {1, 2}};
  evaluator.Evaluate(theta, keys, std::vector<int>(n, r), std::vector<int>(n, 0), returns);
  std::sort(returns.begin(), returns.end());
  CHECK(std::adjacent_find(returns.begin(), returns.end()) == returns.end());
}

TEST_CASE("evaluator: a diverged rollout gets the penalty and is counted") {
  Fixture f(40);
  auto& weights = std::get<GpFactor>(f.factors[0]).weights;
  weights.assign(weights.size(), 1e7);
  const auto returns = f.Returns(25, 1, {});
  std::int64_t diverged = 0;
  for (const double r : returns) {
    CHECK(std::isfinite(r));
    if (r == -40) ++diverged;
  }
  CHECK(diverged > 0);
  CHECK(f.statistics.diverged == diverged);
}

TEST_CASE("evaluator: counts rollouts, queries and lanes") {
  Fixture f(6);
  f.Returns(25, 2, {});
  CHECK(f.statistics.rollouts == 50);
  CHECK(f.statistics.gp_queries == 50 * 6 * 2);
  CHECK(f.statistics.lane_steps == 56 * 6);  // whole vectors of eight doubles
  CHECK(f.statistics.seconds > 0);
}

TEST_CASE("evaluator: idle time is what threads spend without a tile") {
  Fixture f(300);
  EvaluatorOptions options;
  options.threads = 4;
  f.Returns(1, 16, options);  // one tile
  CHECK(f.statistics.IdleShare(4) > 0.5);
  CHECK(f.statistics.IdleShare(4) <= 1);
  f.Returns(60, 16, {});
  CHECK(f.statistics.IdleShare(1) >= 0);
  CHECK(f.statistics.IdleShare(1) < 0.5);
}

TEST_CASE("evaluator: statistics of a batch are what it added") {
  const EvaluatorStatistics before{1, 2, 3, 4, 5, 6, 7}, after{11, 22, 33, 44, 55, 66, 77};
  const EvaluatorStatistics batch = after.Since(before);
  CHECK(batch.rollouts == 10);
  CHECK(batch.steps == 20);
  CHECK(batch.gp_queries == 30);
  CHECK(batch.lane_steps == 40);
  CHECK(batch.diverged == 50);
  CHECK(batch.seconds == 60);
  CHECK(batch.idle_seconds == 70);
  CHECK(batch.LaneFill() == 20.0 / 40);
  CHECK(batch.IdleShare(2) == 70.0 / 120);
}

TEST_CASE("evaluator: a second batch of the same size does not allocate") {
  for (const QueryBackend backend : {QueryBackend::kFused, QueryBackend::kBlas}) {
    Fixture f(6, 30, backend);
    f.policy = MakePolicy(f.task, {.kind = PolicyKind::kGp});  // prepares, and uses scratch
    EvaluatorOptions options;
    options.threads = 2;
    Evaluator evaluator(f.task, *f.policy, f.factors, options);
    const int n = 60;
    std::vector<double> theta(n * f.policy->n_parameters(), 0.1), returns(2 * n);
    std::vector<StreamKey> keys(n);
    std::vector<int> two(n, 2), zero(n, 0);
    const std::vector<CandidateGroup> all_matter, groups = {{n / 2, 5}, {n / 2, 20}};
    for (const auto& g : {all_matter, groups}) {
      evaluator.Evaluate(theta, keys, two, zero, returns, g);
      const long before = allocations;
      evaluator.Evaluate(theta, keys, two, zero, returns, g);
      CHECK(allocations == before);
    }
  }
}

TEST_CASE("evaluator: sizes that disagree are refused") {
  Fixture f;
  EvaluatorOptions no_threads;
  no_threads.threads = 0;
  CHECK_THROWS_AS(Evaluator(f.task, *f.policy, f.factors, no_threads), InvalidInput);
  const std::vector<QueryFactor> one(f.factors.begin(), f.factors.begin() + 1);
  CHECK_THROWS_AS(Evaluator(f.task, *f.policy, one, {}), InvalidInput);
  Evaluator evaluator(f.task, *f.policy, f.factors, {});
  std::vector<double> theta(f.policy->n_parameters()), returns(1), none;
  const std::vector<StreamKey> keys(1);
  const std::vector<int> count(1, 1), zero(1, 0), empty;
  CHECK_THROWS_AS(evaluator.Evaluate(none, keys, count, zero, returns), InvalidInput);
  CHECK_THROWS_AS(evaluator.Evaluate(theta, keys, empty, zero, returns), InvalidInput);
  CHECK_THROWS_AS(evaluator.Evaluate(theta, keys, count, zero, none), InvalidInput);
  CHECK_THROWS_AS(MakePolicy(f.task, {.hidden_units = {0}}), InvalidInput);
}

TEST_CASE("evaluator: one state's features and reward are those of a tile") {
  const Task task = SwingTask(6);
  const std::array<double, 2> state = {0.4, 2.0};
  std::array<double, 3> features;
  ComputeFeatures(task, state, features);
  const double eps = std::numeric_limits<double>::epsilon();
  CHECK(features[0] == 0.4);
  CHECK(std::abs(features[1] - std::cos(2.0)) <= 4 * eps);
  CHECK(std::abs(features[2] - std::sin(2.0)) <= 4 * eps);
  const double d2 = std::pow(std::cos(2.0) + 1, 2) + std::pow(std::sin(2.0), 2);
  CHECK(std::abs(ComputeReward(task, 0, state, std::array<double, 1>{0}) -
                 std::exp(-d2 / (2 * 0.64))) <= 20 * eps);
}

}  // namespace
}  // namespace downpour
