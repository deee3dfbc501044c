// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "engine/errors.h"
#include "engine/rollout/dynamics_prior.h"
#include "engine/rollout/flush_subnormals.h"
#include "tests/rollout/swing_fixture.h"

namespace downpour {
namespace {

// The swing's velocity grows by drift + gain x torque a step, its angle stays; beyond `limit` there
// is no prediction.
class DriftPrior final : public DynamicsPrior {
 public:
  explicit DriftPrior(double limit = std::numeric_limits<double>::infinity()) : limit_(limit) {}
  std::string Describe() const override { return "velocity += drift + gain x torque"; }
  const std::vector<PriorParameter>& parameters() const override { return parameters_; }
  std::unique_ptr<PriorPredictor> MakePredictor() const override {
    auto predictor = std::make_unique<Predictor>();
    predictor->limit = limit_;
    return predictor;
  }

 private:
  struct Predictor final : PriorPredictor {
    void SetParameters(std::span<const double> values) override {
      drift = values[0];
      gain = values[1];
    }
    void PredictTile(int n, const double* states, const double* actions, double* next) override {
      for (int lane = 0; lane < n; ++lane) {
        const double velocity = states[lane] + (drift + gain * actions[lane]);
        next[lane] = std::abs(velocity) < limit ? velocity : NAN;
        next[kTileLanes + lane] = states[kTileLanes + lane];
      }
    }
    double drift = 0, gain = 0, limit = 0;
  };
  std::vector<PriorParameter> parameters_ = {{"drift", "rad/s", -1, 1, 0}, {"gain", "1", 0, 1, 0}};
  double limit_;
};

// One rollout a candidate of the fixture's task with `prior` (nullptr: none).
std::vector<double> Returns(Fixture* fixture, std::shared_ptr<const DynamicsPrior> prior,
                            const std::vector<double>& values, EvaluatorOptions options,
                            EvaluatorStatistics* statistics = nullptr) {
  constexpr int kCandidates = 100;
  fixture->task.prior = std::move(prior);
  std::vector<double> theta(static_cast<std::size_t>(kCandidates) *
                            fixture->policy->n_parameters());
  FillNormals({2, 2}, 0, theta.data(), theta.size());
  std::vector<StreamKey> keys;
  for (std::uint32_t c = 0; c < kCandidates; ++c) {
    keys.push_back(DeriveKey(7, StreamPurpose::kRollout, {c}));
  }
  Evaluator evaluator(fixture->task, *fixture->policy, fixture->factors, options, values);
  std::vector<double> returns(kCandidates);
  evaluator.Evaluate(theta, keys, std::vector<int>(kCandidates, 1),
                     std::vector<int>(kCandidates, 0), returns);
  if (statistics != nullptr) *statistics = evaluator.statistics();
  return returns;
}

TEST_CASE("prior: one that predicts no change leaves every bit as it is without a prior") {
  Fixture fixture;
  for (const bool use_variance : {true, false}) {
    const EvaluatorOptions options{.use_variance = use_variance};
    const auto without = Returns(&fixture, nullptr, {}, options);
    CHECK(Returns(&fixture, std::make_shared<DriftPrior>(), {0, 0}, options) == without);
    CHECK(Returns(&fixture, std::make_shared<DriftPrior>(), {0.1, 0}, options) != without);
  }
}

TEST_CASE("prior: what it predicts and what the model learns add up") {
  // Constant changes of the velocity, which is rewarded; the prior knows a part of them.
  Fixture fixture(6, 30);
  const double drift = 0.25;
  fixture.task.reward = MakeSaturatingReward(fixture.task.feature_names, {1, 0, 0}, {1}, 0.8);
  Eigen::MatrixXd inputs(1, 4);
  inputs << 0, 1, 0, 0;
  const Hyperparameters flat{{1e6, 1e6, 1e6, 1e6}, 1, 1e-8};
  const auto constant = [&](double value) {
    return ExactGp(inputs, Eigen::VectorXd::Constant(1, value), flat).Pack();
  };
  const EvaluatorOptions options{.use_variance = false};
  fixture.factors = {constant(drift + 0.125), constant(0.0625)};
  const auto whole = Returns(&fixture, nullptr, {}, options);
  fixture.factors = {constant(0.125), constant(0.0625)};
  const auto parts = Returns(&fixture, std::make_shared<DriftPrior>(), {drift, 0}, options);
  for (std::size_t c = 0; c < whole.size(); ++c) {
    // Lengthscales of 1e6 bend the constants by 1e-10 at most.
    CHECK(parts[c] == doctest::Approx(whole[c]).epsilon(1e-8));
  }
}

TEST_CASE("prior: the same bits for any number of threads") {
  Fixture fixture;
  const auto prior = std::make_shared<DriftPrior>();
  const auto one = Returns(&fixture, prior, {0.1, 0.05}, {.threads = 1});
  CHECK(Returns(&fixture, prior, {0.1, 0.05}, {.threads = 2}) == one);
  CHECK(Returns(&fixture, prior, {0.1, 0.05}, {.threads = 5}) == one);
}

TEST_CASE("prior: a rollout without a prediction has diverged") {
  Fixture fixture;
  EvaluatorStatistics statistics;
  const auto returns =
      Returns(&fixture, std::make_shared<DriftPrior>(0.9), {0.5, 0}, {}, &statistics);
  CHECK(statistics.diverged == 100);
  CHECK(std::count(returns.begin(), returns.end(), -fixture.task.horizon) == 100);
}

TEST_CASE("prior: its time is counted") {
  Fixture fixture;
  EvaluatorStatistics statistics;
  Returns(&fixture, std::make_shared<DriftPrior>(), {0, 0}, {}, &statistics);
  CHECK(statistics.prior_seconds > 0);
  CHECK(statistics.prior_seconds < statistics.seconds);
  Returns(&fixture, nullptr, {}, {}, &statistics);
  CHECK(statistics.prior_seconds == 0);
}

#if defined(__SSE2__)
TEST_CASE("flush_subnormals: as long as it lives, and only if it is on") {
  const volatile double smallest = std::numeric_limits<double>::min();
  CHECK(smallest / 2 > 0);
  {
    const FlushSubnormals flush(true);
    CHECK(smallest / 2 == 0);
    CHECK(smallest * 1 > 0);
  }
  CHECK(smallest / 2 > 0);
  const FlushSubnormals off(false);
  CHECK(smallest / 2 > 0);
}
#endif

TEST_CASE("prior: another number of parameters is refused") {
  Fixture fixture;
  CHECK_THROWS_WITH_AS(Returns(&fixture, std::make_shared<DriftPrior>(), {0}, {}),
                       "prior: 1 parameters: must be 2", InvalidInput);
  CHECK_THROWS_AS(Returns(&fixture, nullptr, {0}, {}), InvalidInput);
}

}  // namespace
}  // namespace downpour
