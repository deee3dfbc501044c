// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "tests/pilco/check_gradient.h"
#include "tests/pilco/stage_cases.h"

namespace downpour {
namespace {

TEST_CASE("pilco stages: moments are those of samples, covariances of every rank") {
  for (const Stage& stage : AllStages()) {
    for (int rank = 0; rank <= stage.n_inputs; ++rank) {
      CAPTURE(stage.name);
      CAPTURE(rank);
      CHECK(StageDeviation(stage, rank, rank == 0 ? 1000 : 1'000'000) < 4);
    }
  }
}

// A scalar of all moments, of which `weights` are the derivatives.
double Weighted(const Moments& weights, const Moments& moments) {
  return weights.mean.dot(moments.mean) +
         weights.covariance.cwiseProduct(moments.covariance).sum() +
         weights.slope.cwiseProduct(moments.slope).sum();
}

Moments RandomWeights(Eigen::Index in, Eigen::Index out) {
  const int i = static_cast<int>(in), o = static_cast<int>(out);
  return {RandomColumns(o, 1, 80), RandomColumns(o, o, 81), RandomColumns(i, o, 82)};
}

// Mean, then the lower triangle of the covariance.
std::vector<double> Flatten(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance) {
  std::vector<double> x(mean.begin(), mean.end());
  for (Eigen::Index i = 0; i < mean.size(); ++i) {
    for (Eigen::Index j = 0; j <= i; ++j) x.push_back(covariance(i, j));
  }
  return x;
}

void Unflatten(const std::vector<double>& x, Eigen::VectorXd* mean, Eigen::MatrixXd* covariance) {
  std::size_t next = 0;
  for (Eigen::Index i = 0; i < mean->size(); ++i) (*mean)[i] = x[next++];
  for (Eigen::Index i = 0; i < mean->size(); ++i) {
    for (Eigen::Index j = 0; j <= i; ++j) {
      (*covariance)(i, j) = (*covariance)(j, i) = x[next++];
    }
  }
}

TEST_CASE("pilco stages: reverse mode is that of central differences, covariances of every rank") {
  for (const Stage& stage : AllStages()) {
    for (int rank = 0; rank <= stage.n_inputs; ++rank) {
      CAPTURE(stage.name);
      CAPTURE(rank);
      Eigen::VectorXd mean = 0.5 * RandomColumns(stage.n_inputs, 1, 60);
      Eigen::MatrixXd covariance = RandomCovariance(stage.n_inputs, rank, stage.spread, 61);
      const Moments claimed = stage.moments(mean, covariance);
      const Moments weights = RandomWeights(stage.n_inputs, claimed.mean.size());
      GaussianAdjoint adjoint(stage.n_inputs);
      stage.backward(mean, covariance, weights, &adjoint);
      Eigen::MatrixXd both = adjoint.covariance + adjoint.covariance.transpose();
      both.diagonal() /= 2;
      CheckGradient(Flatten(adjoint.mean, both), Flatten(mean, covariance),
                    [&](const std::vector<double>& x) {
                      Unflatten(x, &mean, &covariance);
                      return Weighted(weights, stage.moments(mean, covariance));
                    });
    }
  }
}

TEST_CASE("pilco stages: a policy's gradient is that of central differences, every parameter") {
  for (const PolicyKind kind : {PolicyKind::kLinear, PolicyKind::kGp}) {
    CAPTURE(static_cast<int>(kind));
    const auto policy = MakePolicyMoments(PolicyTask(), {.kind = kind, .points = 5});
    const std::vector<double> theta = RandomNumbers(policy->n_parameters(), 41);
    const Eigen::VectorXd mean = RandomColumns(3, 1, 62);
    const Eigen::MatrixXd covariance = RandomCovariance(3, 3, 0.6, 63);
    const Moments weights = RandomWeights(3, 2);
    policy->SetParameters(theta);
    GaussianAdjoint adjoint(3);
    policy->Backward(mean, covariance, weights, &adjoint);
    std::vector<double> gradient(theta.size());
    policy->Gradient(gradient);
    CheckGradient(gradient, theta, [&](const std::vector<double>& x) {
      policy->SetParameters(x);
      return Weighted(weights, policy->Predict(mean, covariance));
    });
  }
}

TEST_CASE("pilco stages: at a point, policy and squash are the action that the policy takes") {
  const Task task = PolicyTask();
  for (const PolicyKind kind : {PolicyKind::kLinear, PolicyKind::kGp}) {
    const PolicyOptions options{.kind = kind, .points = 5};
    const auto moments = MakePolicyMoments(task, options);
    const auto policy = MakePolicy(task, options);
    REQUIRE(moments->n_parameters() == policy->n_parameters());
    const std::vector<double> theta = RandomNumbers(policy->n_parameters(), 42);
    const std::vector<double> features = RandomNumbers(3, 43);
    std::vector<double> action(2);
    policy->Act(0, theta, features, action);
    moments->SetParameters(theta);
    const Moments raw = moments->Predict(Eigen::Map<const Eigen::VectorXd>(features.data(), 3),
                                         Eigen::MatrixXd::Zero(3, 3));
    const Moments squashed = SquashMoments(task.action_limits, raw.mean, raw.covariance);
    // K + 0.01 I has a condition number of at most 501.
    for (int a = 0; a < 2; ++a) CHECK(std::abs(squashed.mean[a] - action[a]) < 1e-12);
    CHECK(squashed.covariance.cwiseAbs().maxCoeff() < 1e-12);
  }
}

}  // namespace
}  // namespace downpour
