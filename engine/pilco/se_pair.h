// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

namespace downpour {

// What all products of two SE-ARD functions a and b under x ~ N(m, S) have in common, with
// w = 1 / l_a^2 + 1 / l_b^2 and W = diag w:
//   E[k_a(x_i, x) k_b(x_j, x)] = scale Q_ij,
//   Q_ij = exp(-1/2 nu_i^T L_a^-2 nu_i - 1/2 nu_j^T L_b^-2 nu_j + 1/2 z_ij^T G z_ij) <= 1,
//   nu_i = x_i - m,  z_ij = L_a^-2 nu_i + L_b^-2 nu_j,  G = (S^-1 + W)^-1
// (Deisenroth & Rasmussen 2011, Eq. 22, with R = S W + I).
struct SePair {
  Eigen::VectorXd precisions;  // (D) w
  Eigen::MatrixXd g;           // D x D
  double scale = 1;            // |S W + I|^-1/2; signal variances are the caller's
};

// Singular S is an ordinary input: only B = I + W^1/2 S W^1/2 is factorised. `scale` is NaN where
// rounding left an S so far from positive semi-definite that B has no Cholesky factor.
SePair MakeSePair(const Eigen::VectorXd& precisions_a, const Eigen::VectorXd& precisions_b,
                  const Eigen::MatrixXd& covariance);

// Sums over the pairs (i, j) of some weights w_ij Q_ij =: N_ij, or of a share of them.
struct SePairSums {
  Eigen::VectorXd rows;      // sum_j N_ij
  Eigen::VectorXd columns;   // sum_i N_ij
  Eigen::MatrixXd products;  // D x D: sum_ij N_ij a_i b_j^T,  a_i = L_a^-2 nu_i, b_j = L_b^-2 nu_j
};

// Derivatives of the sum F = sum_ij N_ij scale with respect to m and S, if N already holds `scale`
// and all other factors. `a` and `b` are D x n.
void SePairDerivatives(const SePair& pair, const SePairSums& sums, const Eigen::MatrixXd& a,
                       const Eigen::MatrixXd& b, Eigen::VectorXd* by_mean,
                       Eigen::MatrixXd* by_covariance);

}  // namespace downpour
