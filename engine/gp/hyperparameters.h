// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <vector>

namespace downpour {

// Hyper-parameters of one SE-ARD GP (paper Eq. 6).
struct Hyperparameters {
  std::vector<double> lengthscales;  // (D) > 0, units of the inputs
  double signal_std = 1;             // sigma_f > 0, unit of the output
  double noise_std = 0.1;            // sigma_n > 0, unit of the output
};

// Training data: n points, inputs (features, action), targets the state differences.
struct Dataset {
  Eigen::MatrixXd inputs;   // n x D
  Eigen::MatrixXd targets;  // n x E
  int n_points() const { return static_cast<int>(inputs.rows()); }
  int n_inputs() const { return static_cast<int>(inputs.cols()); }
  int n_outputs() const { return static_cast<int>(targets.cols()); }
};

}  // namespace downpour
