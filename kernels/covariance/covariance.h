// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace downpour {

// The two products of CMA-ES with a full covariance matrix, for the few columns of a population:
// OpenBLAS packs its operands first, which takes longer than the products themselves. All matrices
// are column-major, columns one after the other; no alignment is needed, outputs overlap no input.
// Sums run over k in ascending order, in fused multiply-adds; bits depend on the SIMD target alone.
// Thread-safe, do not allocate.

// Y = L Z: L (n x n) lower triangular with zeros above its diagonal, Z and Y (n x m).
void TriangularProduct(int n, int m, const double* l, const double* z, double* y);

// Lower triangle of C = decay C + A diag(weights) A^T, A (n x k; may be nullptr if k = 0).
// Above the diagonal of C (n x n) some elements are updated likewise, the others are left.
void SymmetricProduct(int n, int k, double decay, const double* weights, const double* a,
                      double* c);

}  // namespace downpour
