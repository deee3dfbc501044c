// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "engine/learner/learner.h"
#include "engine/rollout/dynamics_prior.h"

namespace downpour {

// What the Gaussian processes have to learn besides the prior (n x E): next observations less what
// `predictor` says of the observations and actions. Allocates.
Eigen::MatrixXd PriorResiduals(std::span<const Transition> transitions, PriorPredictor* predictor);

// Free parameters of a prior and hyper-parameters of the residuals' model, found together.
struct PriorFit {
  std::vector<double> parameters;
  std::vector<Hyperparameters> hyperparameters;  // (E)
  int evaluations = 0;                           // parameters tried
};

// Maximises the log marginal likelihood of the residuals over both (Chatzilygeroudis & Mouret, ICRA
// 2018): hyper-parameters by FitHyperparameters for each try of the parameters, these within their
// ranges by Sbplx (NLopt's form of Rowan's Subplex), which takes no gradient. `inputs` (n x D) are
// those of the transitions. `last` is the last episode's fit, or has no parameters: then those that
// the prior starts with, and no warm start. Further starts are drawn from (seed, episode, start).
// The result does not depend on `threads`. Throws InvalidInput if the prior has no finite
// prediction of some transition at any start, and Interrupted once `stop` is true.
PriorFit FitPrior(const DynamicsPrior& prior, const std::vector<Transition>& transitions,
                  const Eigen::MatrixXd& inputs, const PriorFit& last,
                  const LearnerOptions& options, std::uint32_t episode, int threads,
                  const std::atomic<bool>* stop);

}  // namespace downpour
