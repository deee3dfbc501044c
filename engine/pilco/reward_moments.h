// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "engine/pilco/moments.h"
#include "engine/rollout/reward.h"

namespace downpour {

// E[exp(-|A f - b|^2 / (2 width^2))] of features f ~ N(mean, covariance) (F) (Deisenroth 2010,
// section 3.7.1), in [0, 1]; NaN where rounding left a covariance so far from positive
// semi-definite that I + A covariance A^T / width^2 has no Cholesky factor. Unless `input` is
// nullptr, adds `weight` times the expectation's derivatives to it. Thread-safe, allocates.
double ExpectedReward(const SaturatingParameters& reward, const Eigen::VectorXd& mean,
                      const Eigen::MatrixXd& covariance, double weight, GaussianAdjoint* input);

}  // namespace downpour
