// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/checks.h"

#include <cmath>
#include <cstdio>
#include <string>

#include "engine/errors.h"

namespace downpour {
namespace {

std::string Text(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%g", value);
  return text;
}

void CheckFinite(const Eigen::Ref<const Eigen::MatrixXd>& matrix, const std::string& name) {
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j) {
      if (std::isfinite(matrix(i, j))) continue;
      throw InvalidInput("GP " + name + ": row " + std::to_string(i) + ", column " +
                         std::to_string(j) + " is " + Text(matrix(i, j)) + ", must be finite");
    }
  }
}

void CheckRange(double value, const std::string& name) {
  if (value >= 1e-150 && value <= 1e150) return;
  throw InvalidInput("GP hyper-parameters: " + name + " is " + Text(value) +
                     ", must be in [1e-150, 1e150]");
}

}  // namespace

void CheckTrainingData(const Eigen::Ref<const Eigen::MatrixXd>& inputs,
                       const Eigen::Ref<const Eigen::MatrixXd>& targets) {
  if (inputs.rows() < 1 || inputs.cols() < 1 || targets.cols() < 1) {
    throw InvalidInput("GP data: " + std::to_string(inputs.rows()) + " points, " +
                       std::to_string(inputs.cols()) + " inputs, " +
                       std::to_string(targets.cols()) + " outputs; each must be at least 1");
  }
  if (inputs.rows() != targets.rows()) {
    throw InvalidInput("GP data: inputs have " + std::to_string(inputs.rows()) +
                       " rows and targets " + std::to_string(targets.rows()) +
                       ", must be the same");
  }
  CheckFinite(inputs, "inputs");
  CheckFinite(targets, "targets");
}

void CheckHyperparameters(const Hyperparameters& hyperparameters, Eigen::Index n_inputs) {
  const auto size = static_cast<Eigen::Index>(hyperparameters.lengthscales.size());
  if (size != n_inputs) {
    throw InvalidInput("GP hyper-parameters: " + std::to_string(size) + " lengthscales, must be " +
                       std::to_string(n_inputs) + ", one an input");
  }
  for (Eigen::Index d = 0; d < size; ++d) {
    CheckRange(hyperparameters.lengthscales[d], "lengthscale " + std::to_string(d));
  }
  CheckRange(hyperparameters.signal_std, "signal_std");
  CheckRange(hyperparameters.noise_std, "noise_std");
}

Eigen::MatrixXd MatrixOfRows(std::span<const double> numbers, int n_columns, const char* name) {
  if (n_columns < 1 || numbers.size() % static_cast<std::size_t>(n_columns) != 0) {
    throw InvalidInput(std::string(name) + ": " + std::to_string(numbers.size()) +
                       " numbers, must be rows of " + std::to_string(n_columns));
  }
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  return Eigen::Map<const RowMajor>(
      numbers.data(), static_cast<Eigen::Index>(numbers.size()) / n_columns, n_columns);
}

}  // namespace downpour
