// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "engine/gp/gp_model.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"

namespace downpour {

struct StateDistribution {
  Eigen::VectorXd mean;        // (E)
  Eigen::MatrixXd covariance;  // E x E
};

// The return that a policy is expected to have on a learnt model, and its gradient: PILCO's policy
// evaluation (Deisenroth & Rasmussen 2011, sections 2.2-2.4; Deisenroth, Fox, Rasmussen 2015). The
// state's distribution is held to be Gaussian at every step; its moments are carried exactly
// through features, policy, squashing function, GPs and reward, each stage's result being held to
// be Gaussian in turn; the gradient is that of this computation in reverse mode, exact to rounding.
//
// Noise: the GPs predict their latent functions, without sigma_n^2. The policy acts on a
// measurement: diag(sigma_n^2 / 2) is added to the state's covariance before the features that it
// sees are taken, half of the learnt noise variances because a target is the difference of two
// measurements. The model and the reward see the state itself; how state and action go together is
// taken as cov(features) E[du/dfeatures]. The authors' program did so up to its version 0.9; its
// last change (19 July 2016) left the measurement noise out.
//
// Covariances are symmetrised at every step and never inverted, so that singular ones (a start
// without spread, a feature that repeats another) are ordinary inputs; eigenvalues that rounding
// made slightly negative are left as they are. Where a chain runs into numbers that are not finite
// or a covariance too far from positive semi-definite to be factorised, its return is -horizon,
// less than that of any other, and its gradient zero.
//
// One object is used by one thread at a time.
class ExpectedReturn {
 public:
  // `model[e]` predicts the change of state e from features, then actions; its prior mean is zero.
  // Pairs of its outputs are shared out among `threads` OpenMP threads; the results have the same
  // bits for any number of them. Throws InvalidInput if the policy is neither gp nor linear, the
  // reward is not saturating, the model does not fit the task, or threads < 1.
  ExpectedReturn(const Task& task, const PolicyOptions& policy, const std::vector<ExactGp>& model,
                 int threads);
  ~ExpectedReturn();
  ExpectedReturn(ExpectedReturn&&) noexcept;
  ExpectedReturn& operator=(ExpectedReturn&&) noexcept;

  int n_parameters() const;  // P, those of MakePolicy's policy

  // Sum over steps 1 ... horizon of the expected reward, in [0, horizon] but for the above; writes
  // the gradient (P) unless `gradient` is empty. O(horizon E^2 n^2 D). Throws InvalidInput if a
  // size is not P. Allocates.
  double Evaluate(std::span<const double> parameters, std::span<double> gradient);

  // Predicted states of steps 0 ... horizon of the last Evaluate; fewer where its chain broke off.
  std::span<const StateDistribution> states() const;

 private:
  class Chain;
  std::unique_ptr<Chain> chain_;
};

}  // namespace downpour
