// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/policy_moments.h"

#include <utility>

#include "engine/errors.h"
#include "engine/pilco/gp_policy_moments.h"

namespace downpour {
namespace {

// a = W x + b.
class LinearPolicyMoments final : public PolicyMoments {
 public:
  LinearPolicyMoments(Eigen::VectorXd input_factors, int n_actions)
      : input_factors_(std::move(input_factors)), n_actions_(n_actions) {}

  int n_parameters() const override {
    return n_actions_ * (static_cast<int>(input_factors_.size()) + 1);
  }

  void SetParameters(std::span<const double> parameters) override {
    const Eigen::Index dim = input_factors_.size();
    weights_ = input_factors_.asDiagonal() *
               Eigen::Map<const Eigen::MatrixXd>(parameters.data(), dim, n_actions_);
    bias_ = Eigen::Map<const Eigen::VectorXd>(parameters.data() + dim * n_actions_, n_actions_);
    by_weights_ = Eigen::MatrixXd::Zero(dim, n_actions_);
    by_bias_ = Eigen::VectorXd::Zero(n_actions_);
  }

  Moments Predict(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance) const override {
    return {weights_.transpose() * mean + bias_, weights_.transpose() * covariance * weights_,
            weights_};
  }

  void Backward(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance,
                const Moments& output, GaussianAdjoint* input) override {
    input->mean += weights_ * output.mean;
    input->covariance += weights_ * output.covariance * weights_.transpose();
    by_bias_ += output.mean;
    by_weights_ += mean * output.mean.transpose() + output.slope +
                   covariance * weights_ * (output.covariance + output.covariance.transpose());
  }

  void Gradient(std::span<double> gradient) const override {
    const Eigen::Index dim = input_factors_.size();
    Eigen::Map<Eigen::MatrixXd>(gradient.data(), dim, n_actions_) =
        input_factors_.asDiagonal() * by_weights_;
    Eigen::Map<Eigen::VectorXd>(gradient.data() + dim * n_actions_, n_actions_) = by_bias_;
  }

 private:
  Eigen::VectorXd input_factors_;
  int n_actions_;
  Eigen::MatrixXd weights_;     // F x A, of the unscaled features
  Eigen::VectorXd bias_;        // (A)
  Eigen::MatrixXd by_weights_;  // F x A
  Eigen::VectorXd by_bias_;     // (A)
};

}  // namespace

std::unique_ptr<PolicyMoments> MakePolicyMoments(const Task& task, const PolicyOptions& options) {
  const bool known = options.kind == PolicyKind::kGp || options.kind == PolicyKind::kLinear;
  if (options.make || !known) {
    throw InvalidInput(
        "policy: moments are known of \"gp\" and \"linear\" only, not of " +
        (options.make
             ? "the user's own"
             : "\"" + std::string(kPolicyKindNames[static_cast<int>(options.kind)]) + "\""));
  }
  CheckPolicyOptions(options);
  Eigen::VectorXd factors(task.n_features());
  for (int f = 0; f < task.n_features(); ++f) factors[f] = 1 / task.policy_input_scale[f];
  if (options.kind == PolicyKind::kLinear) {
    return std::make_unique<LinearPolicyMoments>(factors, task.n_actions());
  }
  const int points = options.points == 0 ? task.policy_points : options.points;
  return std::make_unique<GpPolicyMoments>(factors, points, task.n_actions());
}

}  // namespace downpour
