// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "kernels/aligned.h"

namespace downpour {

enum class Activation { kTanh, kRelu };

// Shape of a feed-forward network (paper section IV-A2).
struct MlpShape {
  std::vector<int> units;                     // inputs, every hidden layer, outputs; >= 1 each
  Activation activation = Activation::kTanh;  // of the hidden layers

  int n_inputs() const { return units.front(); }
  int n_outputs() const { return units.back(); }
  int n_parameters() const {
    int n = 0;
    for (std::size_t l = 1; l < units.size(); ++l) n += (units[l - 1] + 1) * units[l];
    return n;
  }
  // Rows of kTileLanes doubles: two buffers of the widest layer before the outputs.
  int scratch_rows() const { return 2 * *std::max_element(units.begin(), units.end() - 1); }
};

// outputs = limit tanh(W_L y_L + b_L), y_l = activation(W_{l-1} y_{l-1} + b_{l-1}), y_0 =
// input_scale x, for a tile of lanes that each have their own parameters.
//   parameters   n_parameters x kTileLanes: for each layer W_l (units x units of the layer before,
//                row-major), then b_l
//   input_scale  (n_inputs) factors; limits (n_outputs)
//   inputs       n_inputs x kTileLanes; outputs n_outputs x kTileLanes
//   scratch      shape.scratch_rows() x kTileLanes
// Lanes from n_lanes on, rounded up to whole vectors, are left as they are.
// Tile arrays are aligned and do not alias. |output| <= limit. Thread-safe, does not allocate.
void MlpTile(const MlpShape& shape, int n_lanes, const double* parameters,
             const double* input_scale, const double* limits, const double* inputs, double* scratch,
             double* outputs);

}  // namespace downpour
