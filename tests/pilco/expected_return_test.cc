// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/expected_return.h"

#include <doctest/doctest.h>

#include <string>
#include <vector>

#include "engine/errors.h"
#include "tests/pilco/chain_case.h"
#include "tests/pilco/check_gradient.h"

namespace downpour {
namespace {

TEST_CASE("expected return: the states of three steps have the moments of samples of each step") {
  CHECK(ChainDeviation(PolicyKind::kGp, 100'000) < 4);
  CHECK(ChainDeviation(PolicyKind::kLinear, 100'000) < 4);
}

TEST_CASE("expected reward: is the mean of samples, covariances of every rank") {
  for (const int rank : {0, 1, 2, 3}) {
    CAPTURE(rank);
    CHECK(RewardDeviation(rank, rank == 0 ? 1000 : 1'000'000) < 4);
  }
}

TEST_CASE("expected reward: reverse mode is that of central differences") {
  const SaturatingParameters reward{{1, 0.5, 0, 0, 1, -1}, {0.3, -0.2}, 0.8};
  for (const int rank : {0, 1, 3}) {
    CAPTURE(rank);
    const Eigen::VectorXd mean = 0.5 * RandomColumns(3, 1, 72);
    const Eigen::MatrixXd covariance = RandomCovariance(3, rank, 0.5, 73);
    GaussianAdjoint adjoint(3);
    ExpectedReward(reward, mean, covariance, 1, &adjoint);
    std::vector<double> gradient(adjoint.mean.begin(), adjoint.mean.end());
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j <= i; ++j) {
        gradient.push_back(adjoint.covariance(i, j) + (i == j ? 0 : adjoint.covariance(j, i)));
      }
    }
    // About zero: shifts of the mean, then of the lower triangle.
    CheckGradient(gradient, std::vector<double>(9, 0.0), [&](const std::vector<double>& x) {
      Eigen::VectorXd m = mean;
      Eigen::MatrixXd s = covariance;
      std::size_t next = 3;
      for (int i = 0; i < 3; ++i) {
        m[i] += x[i];
        for (int j = 0; j <= i; ++j, ++next) {
          s(i, j) += x[next];
          if (i != j) s(j, i) += x[next];
        }
      }
      return ExpectedReward(reward, m, s, 1, nullptr);
    });
  }
}

TEST_CASE("expected return: the gradient is that of central differences, every parameter") {
  for (const PolicyKind kind : {PolicyKind::kGp, PolicyKind::kLinear}) {
    for (const double start_std : {0.0, 0.3}) {
      CAPTURE(static_cast<int>(kind));
      CAPTURE(start_std);
      Task task = SwingTask(5);
      task.start_std = {start_std, start_std};
      ExpectedReturn expected(task, {.kind = kind, .points = 4}, SwingModel(30), 1);
      const std::vector<double> theta = RandomNumbers(expected.n_parameters(), 3);
      std::vector<double> gradient(theta.size());
      const double value = expected.Evaluate(theta, gradient);
      CHECK(value > 0);
      CHECK(value < 5);
      CHECK(expected.states().size() == 6);
      CHECK(expected.Evaluate(theta, {}) == value);
      CheckGradient(gradient, theta,
                    [&](const std::vector<double>& x) { return expected.Evaluate(x, {}); });
    }
  }
}

TEST_CASE("expected return: without any variance it is the return of the mean's trajectory") {
  Task task = SwingTask(1);
  task.start_std = {0, 0};
  const PolicyOptions options{.kind = PolicyKind::kGp, .points = 4};
  // Almost no noise and a smooth function: the posterior variance is of 1e-8 at the start.
  Eigen::MatrixXd inputs(40, 4), targets(40, 1);
  inputs = RandomColumns(40, 4, 90);
  for (int i = 0; i < 40; ++i) targets(i, 0) = 0.1 * inputs.row(i).sum();
  const Hyperparameters hyper{{20, 20, 20, 20}, 1, 1e-4};
  const std::vector<ExactGp> model = {ExactGp(inputs, targets.col(0), hyper),
                                      ExactGp(inputs, -targets.col(0), hyper)};
  ExpectedReturn expected(task, options, model, 1);
  const std::vector<double> theta = RandomNumbers(expected.n_parameters(), 4);
  const double value = expected.Evaluate(theta, {});
  std::vector<double> features(3), action(1);
  ComputeFeatures(task, task.start_mean, features);
  MakePolicy(task, options)->Act(0, theta, features, action);
  Eigen::VectorXd input(4);
  input << features[0], features[1], features[2], action[0];
  std::vector<double> next = task.start_mean;
  for (int e = 0; e < 2; ++e) {
    double mean = 0, variance = 0;
    model[e].Predict(input, &mean, &variance);
    next[e] += mean;
  }
  CHECK(std::abs(value - ComputeReward(task, 0, next, action)) < 1e-5);
}

TEST_CASE("expected return: same bits for any number of threads") {
  const Task task = SwingTask(6);
  std::vector<std::vector<double>> answers;
  for (const int threads : {1, 2, 5}) {
    ExpectedReturn expected(task, {.kind = PolicyKind::kGp, .points = 6}, SwingModel(50), threads);
    const std::vector<double> theta = RandomNumbers(expected.n_parameters(), 5);
    std::vector<double> answer(theta.size());
    answer.push_back(expected.Evaluate(theta, std::span(answer)));
    answers.push_back(answer);
  }
  CHECK(answers[0] == answers[1]);
  CHECK(answers[0] == answers[2]);
}

TEST_CASE("expected return: a chain that breaks off is worse than any, with gradient zero") {
  ExpectedReturn expected(SwingTask(6), {.kind = PolicyKind::kLinear}, SwingModel(20), 1);
  const std::vector<double> theta(static_cast<std::size_t>(expected.n_parameters()), 1e200);
  std::vector<double> gradient(theta.size(), 7.0);
  CHECK(expected.Evaluate(theta, gradient) == -6);
  CHECK(gradient == std::vector<double>(theta.size(), 0.0));
  // The next evaluation is none the worse.
  const std::vector<double> zeros(theta.size(), 0.0);
  CHECK(expected.Evaluate(zeros, gradient) > 0);
}

class OtherReward final : public Reward {
 public:
  std::string Describe() const override { return "none"; }
  bool InUnitInterval() const override { return true; }
  void EvaluateTile(int, const double*, const double*, const double*, double*) const override {}
};

TEST_CASE("expected return: refuses what it has no moments of") {
  const std::vector<ExactGp> model = SwingModel(10);
  const Task task = SwingTask(6);
  CHECK_THROWS_AS(ExpectedReturn(task, {.kind = PolicyKind::kNeuralNetwork}, model, 1),
                  InvalidInput);
  CHECK_THROWS_AS(ExpectedReturn(task, {.kind = PolicyKind::kDmp}, model, 1), InvalidInput);
  CHECK_THROWS_AS(ExpectedReturn(task, {.kind = PolicyKind::kGp, .points = 300}, model, 1),
                  InvalidInput);
  CHECK_THROWS_AS(ExpectedReturn(task, {.kind = PolicyKind::kGp}, {model[0]}, 1), InvalidInput);
  CHECK_THROWS_AS(ExpectedReturn(task, {.kind = PolicyKind::kGp}, {}, 1), InvalidInput);
  CHECK_THROWS_AS(ExpectedReturn(task, {.kind = PolicyKind::kGp}, model, 0), InvalidInput);
  CHECK_THROWS_AS(ExpectedReturn(task, {.kind = PolicyKind::kGp}, {model[0], SwingModel(9)[1]}, 1),
                  InvalidInput);
  Task other = task;
  other.reward = std::make_shared<OtherReward>();
  CHECK_THROWS_AS(ExpectedReturn(other, {.kind = PolicyKind::kGp}, model, 1), InvalidInput);
  other = task;
  other.features.pop_back();
  CHECK_THROWS_AS(ExpectedReturn(other, {.kind = PolicyKind::kLinear}, model, 1), InvalidInput);
  ExpectedReturn expected(task, {.kind = PolicyKind::kLinear}, model, 1);
  std::vector<double> theta(4), short_gradient(3);
  CHECK_THROWS_AS(expected.Evaluate(theta, short_gradient), InvalidInput);
  theta.pop_back();
  CHECK_THROWS_AS(expected.Evaluate(theta, {}), InvalidInput);
}

}  // namespace
}  // namespace downpour
