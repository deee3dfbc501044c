// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/task.h"

#include "engine/rollout/one_lane.h"
#include "kernels/aligned.h"

namespace downpour {

void ComputeFeatures(const Task& task, std::span<const double> state, std::span<double> features) {
  const AlignedVector<double> states = ToOneLane(state);
  AlignedVector<double> tile(features.size() * kTileLanes);
  FeatureTile(task.features.data(), task.n_features(), states.data(), tile.data());
  FromOneLane(tile, features);
}

}  // namespace downpour
