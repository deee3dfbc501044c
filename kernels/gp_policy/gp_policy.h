// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>

#include "kernels/aligned.h"

namespace downpour {

// Variance of the noise on pseudo-targets (paper, section IV-A1); the signal variance is 1.
inline constexpr double kGpPolicyNoise = 0.01;
// A log length-scale is clipped to +-this, so that nothing overflows.
inline constexpr double kMaxLogLengthscale = 50;

// One small GP an output on n_points pseudo-inputs that all outputs share.
struct GpPolicyShape {
  int n_inputs = 0;
  int n_points = 0;
  int n_outputs = 0;
  int n_parameters() const { return n_points * n_inputs + n_outputs * (n_points + n_inputs); }
  // Of one output, as GpPolicyPrepareTile leaves them: c_f = sqrt(log2(e) / 2) / lengthscale_f
  // (n_inputs rows), c_f z_f of every pseudo-input z (n_points x n_inputs), alpha (n_points).
  int prepared_rows() const { return n_inputs + n_points * (n_inputs + 1); }
  // Rows of kTileLanes doubles: what is prepared for each output, then the workspace of either
  // step: a triangle for one vector of up to kVectorLanes lanes, or scaled inputs.
  int scratch_rows() const {
    const int triangle = n_points * (n_points + 1) / 2 * kVectorLanes;
    return n_outputs * prepared_rows() +
           std::max((triangle + kTileLanes - 1) / kTileLanes, n_inputs);
  }
  static constexpr int kVectorLanes = 8;
};

// The GP policy (paper, section IV-A1) for a tile of lanes that each have their own parameters:
//   output = limit kappa(k^T alpha), alpha = (K + 0.01 I)^-1 p, kappa(a) = 9/8 sin a + 1/8 sin 3a,
//   k_i = exp(-1/2 sum_f ((input_scale_f x_f - z_if) / lengthscale_f)^2), K likewise.
//   parameters   n_parameters x kTileLanes in the order pseudo-inputs z (n_points x n_inputs,
//                row-major), pseudo-targets p (n_outputs x n_points), log lengthscales (n_outputs x
//                n_inputs)
//   input_scale  (n_inputs) factors; limits (n_outputs)
//   inputs       n_inputs x kTileLanes; outputs n_outputs x kTileLanes
//   scratch      shape.scratch_rows() x kTileLanes
// Lanes from n_lanes on, rounded up to whole vectors, are left as they are.
// Tile arrays are aligned and do not alias. |output| <= limit. K + 0.01 I has a Cholesky factor
// even if pseudo-inputs coincide: its eigenvalues are 0.01 at least. Thread-safe, do not allocate.

// Writes what depends on the parameters alone, n_points^3 / 3 operations a lane and output.
void GpPolicyPrepareTile(const GpPolicyShape& shape, int n_lanes, const double* parameters,
                         double* scratch);
// One step; `scratch` as GpPolicyPrepareTile left it.
void GpPolicyTile(const GpPolicyShape& shape, int n_lanes, const double* input_scale,
                  const double* limits, const double* inputs, double* scratch, double* outputs);

}  // namespace downpour
