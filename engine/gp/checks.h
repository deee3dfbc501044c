// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <span>

#include "engine/gp/hyperparameters.h"

namespace downpour {

// Throws InvalidInput unless inputs (n x D) and targets (n x E) have n, D, E >= 1, the same n, and
// finite entries only; the message names the row and column (from 0) of the first bad entry.
// Thread-safe.
void CheckTrainingData(const Eigen::Ref<const Eigen::MatrixXd>& inputs,
                       const Eigen::Ref<const Eigen::MatrixXd>& targets);

// Throws InvalidInput unless there are `n_inputs` lengthscales and each hyper-parameter lies in
// [1e-150, 1e150], so that its square is an ordinary number. Thread-safe.
void CheckHyperparameters(const Hyperparameters& hyperparameters, Eigen::Index n_inputs);

// The matrix of row-major numbers with that many columns; no rows of none. Throws InvalidInput,
// with `name`, unless these are whole rows. Thread-safe, allocates.
Eigen::MatrixXd MatrixOfRows(std::span<const double> numbers, int n_columns, const char* name);

}  // namespace downpour
