// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "engine/pilco/expected_return.h"
#include "engine/pilco/reward_moments.h"
#include "tests/pilco/stage_cases.h"

namespace downpour {

// Worst deviation of the states that ExpectedReturn predicts over three steps of SwingTask, in
// standard errors of `n` samples a step. A step's samples are of (state, features, action), jointly
// Gaussian as the stages' moments have it, and of the change that the GPs then predict.
inline double ChainDeviation(PolicyKind kind, std::int64_t n) {
  Task task = SwingTask(3);
  task.start_std = {0.3, 0.2};
  const PolicyOptions options{.kind = kind, .points = 4};
  const std::vector<ExactGp> model = SwingModel(8);
  ExpectedReturn expected(task, options, model, 1);
  const std::vector<double> theta = RandomNumbers(expected.n_parameters(), 70);
  expected.Evaluate(theta, {});
  const auto policy = MakePolicyMoments(task, options);
  policy->SetParameters(theta);
  Eigen::VectorXd noise(2);
  for (int e = 0; e < 2; ++e) {
    const double noise_std = model[e].hyperparameters().noise_std;
    noise[e] = noise_std * noise_std / 2;
  }
  double worst = 0;
  for (int t = 0; t < 3; ++t) {
    const StateDistribution& state = expected.states()[t];
    const StateDistribution& next = expected.states()[t + 1];
    const Moments features = FeatureMoments(task.features, state.mean, state.covariance);
    Eigen::MatrixXd noisy = state.covariance;
    noisy.diagonal() += noise;
    const Moments seen = FeatureMoments(task.features, state.mean, noisy);
    const Moments raw = policy->Predict(seen.mean, seen.covariance);
    const Moments action = SquashMoments(task.action_limits, raw.mean, raw.covariance);
    const Eigen::MatrixXd action_slope = raw.slope * action.slope;
    const Eigen::MatrixXd state_features = state.covariance * features.slope;
    Eigen::VectorXd mean(6);
    mean << state.mean, features.mean, action.mean;
    Eigen::MatrixXd joint = Eigen::MatrixXd::Zero(6, 6);
    joint.topLeftCorner(2, 2) = state.covariance;
    joint.block(0, 2, 2, 3) = state_features;
    joint.block(0, 5, 2, 1) = state_features * action_slope;
    joint.block(2, 2, 3, 3) = features.covariance;
    joint.block(2, 5, 3, 1) = features.covariance * action_slope;
    joint(5, 5) = action.covariance(0, 0);
    const Eigen::MatrixXd full = joint.selfadjointView<Eigen::Upper>();
    // Only then are the samples those of `full`.
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(full);
    if (eigen.eigenvalues().minCoeff() < -1e-12) return HUGE_VAL;
    const Moments claimed{next.mean, next.covariance, Eigen::MatrixXd::Zero(6, 2)};
    const Eigen::MatrixXd root = SquareRoot(full);
    worst = std::max(
        worst, WorstDeviation(
                   Eigen::VectorXd::Zero(6), Eigen::MatrixXd::Identity(6, 6), claimed, n,
                   [&](const Eigen::VectorXd& z, Eigen::VectorXd* y, Eigen::VectorXd* variance) {
                     const Eigen::VectorXd x = mean + root * z;
                     for (int e = 0; e < 2; ++e) {
                       double change = 0;
                       model[e].Predict(x.tail(4), &change, &(*variance)[e]);
                       (*y)[e] = x[e] + change;
                     }
                   },
                   false));
  }
  return worst;
}

// Of an expected reward.
inline double RewardDeviation(int rank, std::int64_t n) {
  const SaturatingParameters reward{{1, 0.5, 0, 0, 1, -1}, {0.3, -0.2}, 0.8};
  const Eigen::VectorXd mean = 0.5 * RandomColumns(3, 1, 72);
  const Eigen::MatrixXd covariance = RandomCovariance(3, rank, 0.5, 73);
  const auto reward_of = [&](const Eigen::VectorXd& f) {
    const double y0 = f[0] + 0.5 * f[1] - 0.3, y1 = f[1] - f[2] + 0.2;
    return std::exp(-(y0 * y0 + y1 * y1) / (2 * 0.8 * 0.8));
  };
  Moments claimed = ZeroMoments(3, 2);
  claimed.mean[0] = ExpectedReward(reward, mean, covariance, 1, nullptr);
  // E r^2 is the expected reward of a width smaller by sqrt 2.
  SaturatingParameters squared = reward;
  squared.width /= std::sqrt(2.0);
  claimed.covariance(0, 0) =
      ExpectedReward(squared, mean, covariance, 1, nullptr) - claimed.mean[0] * claimed.mean[0];
  GaussianAdjoint slope(3);
  ExpectedReward(reward, mean, covariance, 1, &slope);
  claimed.slope.col(0) = slope.mean;
  return WorstDeviation(mean, covariance, claimed, n,
                        [&](const Eigen::VectorXd& x, Eigen::VectorXd* y, Eigen::VectorXd*) {
                          (*y)[0] = reward_of(x);
                          (*y)[1] = 0;
                        });
}

}  // namespace downpour
