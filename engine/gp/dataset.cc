// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/dataset.h"

#include <cstddef>
#include <string>

#include "engine/errors.h"
#include "engine/gp/checks.h"

namespace downpour {

Dataset MakeDataset(std::span<const double> inputs, int n_inputs, std::span<const double> targets,
                    int n_outputs) {
  if (n_inputs < 1 || n_outputs < 1) {
    throw InvalidInput("data: " + std::to_string(n_inputs) + " inputs and " +
                       std::to_string(n_outputs) + " outputs, must be at least 1 of each");
  }
  const std::size_t n = inputs.size() / static_cast<std::size_t>(n_inputs);
  if (inputs.size() != n * n_inputs || targets.size() != n * n_outputs) {
    throw InvalidInput("data: " + std::to_string(inputs.size()) + " numbers of inputs and " +
                       std::to_string(targets.size()) +
                       " of targets, must be as many rows of both: of " + std::to_string(n_inputs) +
                       " and " + std::to_string(n_outputs));
  }
  Dataset data{MatrixOfRows(inputs, n_inputs, "inputs"),
               MatrixOfRows(targets, n_outputs, "targets")};
  CheckTrainingData(data.inputs, data.targets);
  return data;
}

}  // namespace downpour
