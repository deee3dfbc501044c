// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace downpour {

// Rows and columns of SeProductSums are padded to a multiple of this.
inline constexpr int kSeProductPad = 8;

// The products of two SE-ARD functions' kernels under a Gaussian, one entry a pair of points:
//   N_ij = w_ij 2^-max(0, s_ij),  s_ij = u_i + v_j + p_i . b_j
// (engine/pilco/se_pair.h). `ld` is n rounded up to a multiple of kSeProductPad.
struct SeProduct {
  int n = 0, dim = 0, ld = 0;
  const double* u = nullptr;  // (ld)
  const double* v = nullptr;  // (ld)
  const double* p = nullptr;  // ld x dim, row i is p_i
  const double* b = nullptr;  // dim x ld, column j is b_j
  // Either w_ij = row_weights_i column_weights_j (ld each, zero from n on) ...
  const double* row_weights = nullptr;
  const double* column_weights = nullptr;
  // ... or, where `weights` is set, w_ij is `weights`, ld x ld, zero above the diagonal and from n
  // on: only the lower triangle is computed.
  const double* weights = nullptr;
};

// Sums over the pairs.
struct SeProductResult {
  double* rows = nullptr;     // (ld) sum_j N_ij
  double* columns = nullptr;  // (ld) sum_i N_ij; nullptr: `rows` alone is wanted
  double* moments = nullptr;  // ld x dim: row i is sum_j N_ij b_j
};

// Doubles of scratch.
inline std::size_t SeProductScratch(int ld) { return 4 * static_cast<std::size_t>(ld); }

// All arrays are aligned to kAlignment, finite up to ld, and do not alias. An error of a sum is at
// most eps (8 + n + c) times the sum of the absolute values of its terms, c = (dim + 2) times the
// largest |u_i| + |v_j| + |p_i| . |b_j| of a term (the exponent's rounding). `rows` has the same
// bits with and without the other sums. Thread-safe, does not allocate.
void SeProductSums(const SeProduct& product, double* scratch, const SeProductResult& result);

}  // namespace downpour
