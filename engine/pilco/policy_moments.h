// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>

#include "engine/pilco/moments.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"

namespace downpour {

// Exact moments of what a policy of engine/rollout/policy.h squashes, at Gaussian features: a = W x
// + b (linear) or a = k(x)^T (K + 0.01 I)^-1 p (gp), x = features / policy_input_scale. The action
// is SquashMoments of it. A gp policy is its mean function: no variance of its own is added
// (Deisenroth et al. 2015, section 3.5.2). One object is used by one thread at a time.
class PolicyMoments {
 public:
  virtual ~PolicyMoments() = default;
  virtual int n_parameters() const = 0;  // P
  // Takes parameters (P) in the order of MakePolicy, and sets the gradient to zero.
  virtual void SetParameters(std::span<const double> parameters) = 0;
  // F features to A numbers; slope F x A. Allocates.
  virtual Moments Predict(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance) const = 0;
  // Reverse mode: adds what `output` (derivatives with respect to Predict's result there) comes to,
  // to `input` and to the gradient.
  virtual void Backward(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance,
                        const Moments& output, GaussianAdjoint* input) = 0;
  // The gradient (P) of all calls of Backward since SetParameters.
  virtual void Gradient(std::span<double> gradient) const = 0;
};

// Throws InvalidInput unless the policy is MakePolicy's `gp` or `linear`, or as that does.
std::unique_ptr<PolicyMoments> MakePolicyMoments(const Task& task, const PolicyOptions& options);

}  // namespace downpour
