// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

namespace downpour {

// A dynamic movement primitive (Ijspeert et al., Neural Computation 25, 2013, Eq. 2.1-2.4), its
// forcing term without the factor goal - start, so that it acts when both are equal (as in Pastor
// et al., ICRA 2009). With time s = t / horizon in [0, 1]:
//   y'' = w0^2 (g + f - y) - 2 w0 y',  y(0) = y'(0) = 0,  w0 = 12.5  (alpha_z = 25, beta_z = 6.25)
//   f = x sum_i Psi_i(x) w_i / sum_i Psi_i(x),  x = exp(-alpha_x s),  x(1) = 0.01
//   Psi_i = exp(-h_i (x - c_i)^2), c_i = x at n_basis even times in [0, 1], h_i = 1 / (c_i -
//   c_{i+1})^2, the last h as that before; a single basis has c = 1, h = 1
// g + f is held for one step, within which y is exact.
//
// y depends linearly on goal and weights: returns what each adds to it, horizon x (n_basis + 1)
// row-major, row t is y at the end of step t (from 0) for g = 1, w_1 = 1, ..., w_n = 1 alone.
std::vector<double> MovementPrimitiveResponse(int horizon, int n_basis);

}  // namespace downpour
