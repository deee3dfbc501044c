// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "engine/gp/hyperparameters.h"

namespace downpour {

// Training data from row-major numbers, a row a point: inputs n x n_inputs, targets n x n_outputs,
// both copied. Throws InvalidInput unless there is at least one point, input and output, the sizes
// agree and all numbers are finite. Thread-safe, allocates.
Dataset MakeDataset(std::span<const double> inputs, int n_inputs, std::span<const double> targets,
                    int n_outputs);

}  // namespace downpour
