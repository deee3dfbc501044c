// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

namespace downpour {

// Exact SE-ARD GP of one output that answers one query at a time, the way the GP libraries of the
// field do (limbo's GP, which the authors of Black-DROPS use): points and k(x) on the heap, one
// scalar kernel evaluation a point, one triangular solve a query. For comparison only. Measured
// beside limbo's MultiGP (D = 6, four outputs, -O3 -march=native, one thread) it is 2 to 14 %
// faster at n = 40 to 600.
class PerQueryGp {
 public:
  // inputs n x dim column-major, lengthscales (dim), cholesky n x n column-major (L, K = L L^T),
  // alpha (n) = K^-1 y. Copies all.
  PerQueryGp(int n, int dim, const double* inputs, const double* lengthscales, double signal_std,
             const double* cholesky, const double* alpha);
  ~PerQueryGp();

  // Mean and latent variance at x (dim). Allocates.
  void Query(const double* x, double* mean, double* variance) const;

 private:
  struct Model;
  std::unique_ptr<const Model> model_;
};

}  // namespace downpour
