// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <span>

#include "engine/pilco/moments.h"
#include "kernels/features/features.h"

namespace downpour {

// Exact moments of features (values, cosines and sines of state variables, in any order and number)
// of a state N(mean, covariance): E states, F features (Deisenroth 2010, appendix A.1). Differences
// of exponentials are taken without cancellation, so that small variances keep their digits. State
// indices must lie in [0, E). Thread-safe, allocates.
Moments FeatureMoments(std::span<const Feature> features, const Eigen::VectorXd& mean,
                       const Eigen::MatrixXd& covariance);

// Reverse mode: adds to `input` what `output` (derivatives with respect to FeatureMoments' result)
// comes to. Thread-safe, allocates nothing.
void FeatureMomentsBackward(std::span<const Feature> features, const Eigen::VectorXd& mean,
                            const Eigen::MatrixXd& covariance, const Moments& output,
                            GaussianAdjoint* input);

}  // namespace downpour
