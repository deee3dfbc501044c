// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace downpour {

// Doubles of scratch that GpLikelihood takes for n points.
std::size_t GpLikelihoodScratch(int n);

// Log marginal likelihood of a zero-mean SE-ARD GP and its gradient with respect to
// (log l_1 ... log l_D, log sigma_f, log sigma_n) (Rasmussen & Williams 2006, Eq. 5.8 and 5.9):
//   K = signal_variance exp(-1/2 sum_d ((x_id - x_jd) / l_d)^2) + noise_variance I = L L^T
//   value = -1/2 y^T K^-1 y - sum_i log L_ii - n/2 log 2 pi
//   scaled    D x ld row-major: row d holds x_id / l_d, finite, for i in [0, n), and anything
//             finite up to ld >= n rounded up to a multiple of 8
//   targets   n
//   scratch   GpLikelihoodScratch(n) doubles, aligned to kAlignment
//   gradient  D + 2, or nullptr for the value alone
// Returns NaN where K has no Cholesky factor in double precision; `gradient` is then as it was.
// Error of the value <= eps c (y^T K^-1 y + n), of a gradient's entry eps c times the sum of the
// absolute values of its terms, c = (2 D + 8) (1 + n signal_variance / noise_variance).
// Takes n^3 floating-point operations (a third of them for the value alone) in tiles that stay in
// registers. Thread-safe, does not allocate.
double GpLikelihood(int n, int dim, const double* scaled, int ld, const double* targets,
                    double signal_variance, double noise_variance, double* scratch,
                    double* gradient);

}  // namespace downpour
