// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <span>

#include "engine/gp/hyperparameters.h"
#include "engine/rollout/task.h"

namespace downpour {

// Training data of the model: inputs (features, action) and targets next observation - observation
// from the transitions.csv of run directories, their first `episodes` episodes each, one run after
// the other in the order given. Throws InvalidInput for a run of another task or without rows, and
// std::runtime_error for a file that cannot be read.
Dataset ReadDataset(const Task& task, std::span<const std::filesystem::path> runs, int episodes);

}  // namespace downpour
