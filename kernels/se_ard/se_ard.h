// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace downpour {

// Lower triangle (diagonal included) of the noise-free SE-ARD covariance matrix
//   K_ij = signal_variance * exp(-1/2 sum_d ((x_id - x_jd) / l_d)^2)        (paper Eq. 6)
//   scaled   D x ld row-major: row d holds x_id / l_d for i in [0, n); ld >= n
//   k        n x n column-major, leading dimension ldk; entries above the diagonal are not written
// No alignment is needed. Relative error of an entry <= (2 D + 8) eps (1 + its exponent).
// Thread-safe, does not allocate.
void SeArdCovarianceLower(int n, int dim, const double* scaled, int ld, double signal_variance,
                          double* k, int ldk);

}  // namespace downpour
