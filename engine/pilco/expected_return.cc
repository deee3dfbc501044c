// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/expected_return.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "engine/errors.h"
#include "engine/pilco/feature_moments.h"
#include "engine/pilco/gp_moments.h"
#include "engine/pilco/policy_moments.h"
#include "engine/pilco/reward_moments.h"
#include "engine/pilco/squash_moments.h"

namespace downpour {
namespace {

// What a step's reverse needs of its forward pass.
struct StepRecord {
  Moments noisy_features, squash_input, squash, change;
  Eigen::MatrixXd action_slope;  // F x A, E[du/df]^T
  Eigen::MatrixXd change_slope;  // F x E, E[dchange/df]^T, through the action, too
  GpMoments::Record gp;
};

const SaturatingParameters& SaturatingOf(const Task& task) {
  const SaturatingParameters* const reward =
      task.reward == nullptr ? nullptr : task.reward->saturating();
  if (reward == nullptr) {
    throw InvalidInput(
        "expected return: the reward must be a saturating one, as its expectation "
        "has a closed form");
  }
  return *reward;
}

bool IsFinite(const StateDistribution& state) {
  return state.mean.allFinite() && state.covariance.allFinite();
}

}  // namespace

class ExpectedReturn::Chain {
 public:
  Chain(const Task& task, const PolicyOptions& policy, const std::vector<ExactGp>& model,
        int threads)
      : task_(task),
        reward_(SaturatingOf(task)),
        policy_(MakePolicyMoments(task, policy)),
        gps_(model),
        threads_(threads),
        noise_(task.n_states()) {
    const std::size_t n = model.size();
    if (task.n_states() != static_cast<int>(n) || task.n_inputs() != gps_.n_inputs()) {
      throw InvalidInput("expected return: the model has " + std::to_string(n) + " outputs of " +
                         std::to_string(gps_.n_inputs()) + " inputs, must have " +
                         std::to_string(task.n_states()) + " of " +
                         std::to_string(task.n_inputs()));
    }
    if (task.prior != nullptr) {
      throw InvalidInput("expected return: the model's prior mean must be zero");
    }
    if (threads < 1) {
      throw InvalidInput("threads = " + std::to_string(threads) + ": must be at least 1");
    }
    for (std::size_t e = 0; e < n; ++e) {
      const double noise_std = model[e].hyperparameters().noise_std;
      noise_[static_cast<Eigen::Index>(e)] = noise_std * noise_std / 2;
    }
  }

  int n_parameters() const { return policy_->n_parameters(); }
  std::span<const StateDistribution> states() const { return states_; }

  double Evaluate(std::span<const double> parameters, std::span<double> gradient) {
    const auto size = static_cast<std::size_t>(n_parameters());
    if (parameters.size() != size || (!gradient.empty() && gradient.size() != size)) {
      throw InvalidInput("expected return: parameters and gradient must have " +
                         std::to_string(size) + " entries");
    }
    policy_->SetParameters(parameters);
    const bool with_gradient = !gradient.empty();
    const double value = Forward(with_gradient);
    const bool sound = std::isfinite(value);
    if (with_gradient && sound) {
      Reverse();
      policy_->Gradient(gradient);
    }
    const auto is_finite = [](double x) { return std::isfinite(x); };
    if (sound && std::all_of(gradient.begin(), gradient.end(), is_finite)) return value;
    std::fill(gradient.begin(), gradient.end(), 0.0);
    return DivergedReturn(true, task_.horizon);
  }

 private:
  // NaN where the chain broke off.
  double Forward(bool with_gradient) {
    const auto horizon = static_cast<std::size_t>(task_.horizon);
    const Eigen::Index n = task_.n_states();
    records_.resize(with_gradient ? horizon : 1);
    states_.clear();
    states_.push_back({Eigen::Map<const Eigen::VectorXd>(task_.start_mean.data(), n),
                       Eigen::Map<const Eigen::ArrayXd>(task_.start_std.data(), n)
                           .square()
                           .matrix()
                           .asDiagonal()});
    features_.assign(1, Features(states_[0]));
    double value = 0;
    for (std::size_t t = 0; t < horizon; ++t) {
      StateDistribution next =
          Step(states_[t], features_[t], with_gradient, &records_[with_gradient ? t : 0]);
      if (!IsFinite(next)) return std::numeric_limits<double>::quiet_NaN();
      states_.push_back(std::move(next));
      features_.push_back(Features(states_[t + 1]));
      value +=
          ExpectedReward(reward_, features_[t + 1].mean, features_[t + 1].covariance, 1, nullptr);
    }
    return value;
  }

  Moments Features(const StateDistribution& state) const {
    return FeatureMoments(task_.features, state.mean, state.covariance);
  }

  StateDistribution Noisy(const StateDistribution& state) const {
    StateDistribution noisy = state;
    noisy.covariance.diagonal() += noise_;
    return noisy;
  }

  // Deisenroth & Rasmussen 2011, Eq. 10-12.
  StateDistribution Step(const StateDistribution& state, const Moments& features,
                         bool with_gradient, StepRecord* record) const {
    record->noisy_features = Features(Noisy(state));
    record->squash_input =
        policy_->Predict(record->noisy_features.mean, record->noisy_features.covariance);
    record->squash = SquashMoments(task_.action_limits, record->squash_input.mean,
                                   record->squash_input.covariance);
    record->action_slope = record->squash_input.slope * record->squash.slope;

    const Eigen::Index f = task_.n_features(), a = task_.n_actions();
    Eigen::VectorXd mean(f + a);
    Eigen::MatrixXd covariance(f + a, f + a);
    mean << features.mean, record->squash.mean;
    const Eigen::MatrixXd cross = features.covariance * record->action_slope;
    covariance << features.covariance, cross, cross.transpose(), record->squash.covariance;
    record->change =
        gps_.Predict(mean, covariance, threads_, with_gradient ? &record->gp : nullptr);

    const Eigen::MatrixXd& slope = record->change.slope;
    record->change_slope = slope.topRows(f) + record->action_slope * slope.bottomRows(a);
    const Eigen::MatrixXd with_state = state.covariance * features.slope * record->change_slope;
    StateDistribution next{state.mean + record->change.mean,
                           state.covariance + record->change.covariance};
    next.covariance += with_state + with_state.transpose();
    next.covariance = ((next.covariance + next.covariance.transpose()) / 2).eval();
    return next;
  }

  // Derivatives of the return with respect to the state of step t + 1 become those of step t.
  GaussianAdjoint ReverseStep(std::size_t t, const GaussianAdjoint& next) {
    const Eigen::Index f = task_.n_features(), a = task_.n_actions();
    const StepRecord& record = records_[t];
    const StateDistribution& state = states_[t];
    GaussianAdjoint by_state = next;
    Moments by_features = ZeroMoments(task_.n_states(), f);
    const Eigen::MatrixXd by_with_state = next.covariance + next.covariance.transpose();
    const Eigen::MatrixXd state_slope = features_[t].slope * record.change_slope;
    by_state.covariance += by_with_state * state_slope.transpose();
    const Eigen::MatrixXd by_state_slope = state.covariance * by_with_state;
    by_features.slope = by_state_slope * record.change_slope.transpose();
    const Eigen::MatrixXd by_change_slope = features_[t].slope.transpose() * by_state_slope;
    Eigen::MatrixXd by_action_slope =
        by_change_slope * record.change.slope.bottomRows(a).transpose();

    Moments by_change{next.mean, next.covariance, Eigen::MatrixXd(f + a, task_.n_states())};
    by_change.slope << by_change_slope, record.action_slope.transpose() * by_change_slope;
    GaussianAdjoint by_input(f + a);
    gps_.Backward(record.gp, record.change, by_change, &by_input);

    const Eigen::MatrixXd by_cross = by_input.covariance.topRightCorner(f, a) +
                                     by_input.covariance.bottomLeftCorner(a, f).transpose();
    by_features.mean = by_input.mean.head(f);
    by_features.covariance =
        by_input.covariance.topLeftCorner(f, f) + by_cross * record.action_slope.transpose();
    by_action_slope += features_[t].covariance * by_cross;

    const Moments by_action{by_input.mean.tail(a), by_input.covariance.bottomRightCorner(a, a),
                            record.squash_input.slope.transpose() * by_action_slope};
    GaussianAdjoint by_squash_input(a);
    SquashMomentsBackward(task_.action_limits, record.squash_input.mean,
                          record.squash_input.covariance, by_action, &by_squash_input);
    GaussianAdjoint by_noisy(f);
    policy_->Backward(record.noisy_features.mean, record.noisy_features.covariance,
                      {by_squash_input.mean, by_squash_input.covariance,
                       by_action_slope * record.squash.slope.transpose()},
                      &by_noisy);
    const StateDistribution noisy = Noisy(state);
    FeatureMomentsBackward(
        task_.features, noisy.mean, noisy.covariance,
        {by_noisy.mean, by_noisy.covariance, Eigen::MatrixXd::Zero(task_.n_states(), f)},
        &by_state);
    if (t > 0) AddReward(t, &by_features);
    FeatureMomentsBackward(task_.features, state.mean, state.covariance, by_features, &by_state);
    return by_state;
  }

  // The reward of the state of step t.
  void AddReward(std::size_t t, Moments* by_features) const {
    GaussianAdjoint by_reward(task_.n_features());
    ExpectedReward(reward_, features_[t].mean, features_[t].covariance, 1, &by_reward);
    by_features->mean += by_reward.mean;
    by_features->covariance += by_reward.covariance;
  }

  void Reverse() {
    const std::size_t last = states_.size() - 1;
    Moments by_features = ZeroMoments(task_.n_states(), task_.n_features());
    AddReward(last, &by_features);
    GaussianAdjoint by_state(task_.n_states());
    FeatureMomentsBackward(task_.features, states_[last].mean, states_[last].covariance,
                           by_features, &by_state);
    for (std::size_t t = last; t-- > 0;) by_state = ReverseStep(t, by_state);
  }

  Task task_;
  const SaturatingParameters& reward_;  // the task's
  std::unique_ptr<PolicyMoments> policy_;
  GpMoments gps_;
  int threads_;
  Eigen::VectorXd noise_;  // (E) sigma_n^2 / 2
  std::vector<StateDistribution> states_;
  std::vector<Moments> features_;  // of states_
  std::vector<StepRecord> records_;
};

ExpectedReturn::ExpectedReturn(const Task& task, const PolicyOptions& policy,
                               const std::vector<ExactGp>& model, int threads)
    : chain_(std::make_unique<Chain>(task, policy, model, threads)) {}
ExpectedReturn::~ExpectedReturn() = default;
ExpectedReturn::ExpectedReturn(ExpectedReturn&&) noexcept = default;
ExpectedReturn& ExpectedReturn::operator=(ExpectedReturn&&) noexcept = default;

int ExpectedReturn::n_parameters() const { return chain_->n_parameters(); }

double ExpectedReturn::Evaluate(std::span<const double> parameters, std::span<double> gradient) {
  return chain_->Evaluate(parameters, gradient);
}

std::span<const StateDistribution> ExpectedReturn::states() const { return chain_->states(); }

}  // namespace downpour
