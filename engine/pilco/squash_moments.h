// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <span>

#include "engine/pilco/moments.h"

namespace downpour {

// Exact moments of u_i = limits_i kappa(a_i), kappa(a) = 9/8 sin a + 1/8 sin 3a (the policy's
// squashing function; Deisenroth et al. 2015, section 3.4), a ~ N(mean, covariance). A sizes.
// Thread-safe, allocates.
Moments SquashMoments(std::span<const double> limits, const Eigen::VectorXd& mean,
                      const Eigen::MatrixXd& covariance);

// Reverse mode: adds to `input` what `output` (derivatives with respect to SquashMoments' result)
// comes to. Thread-safe, allocates.
void SquashMomentsBackward(std::span<const double> limits, const Eigen::VectorXd& mean,
                           const Eigen::MatrixXd& covariance, const Moments& output,
                           GaussianAdjoint* input);

}  // namespace downpour
