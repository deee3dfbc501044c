// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/learnt_policy.h"

#include <utility>

namespace downpour {

LearntPolicy::LearntPolicy(Task task, std::shared_ptr<const Policy> policy,
                           std::vector<double> parameters)
    : task_(std::move(task)), policy_(std::move(policy)), parameters_(std::move(parameters)) {}

void LearntPolicy::Act(int step, std::span<const double> state, std::span<double> action) const {
  std::vector<double> features(task_.n_features());
  ComputeFeatures(task_, state, features);
  policy_->Act(step, parameters_, features, action);
}

}  // namespace downpour
