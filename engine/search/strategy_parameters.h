// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

namespace downpour {

// What CMA-ES adapts beside the mean and the step size.
enum class CovarianceForm {
  kAuto,           // kFull up to kMaxFullDimension parameters, kLimitedMemory above
  kFull,           // the whole matrix
  kDiagonal,       // its diagonal only, which learns P / 3 times faster
  kLimitedMemory,  // some 4 + 3 ln P directions, for thousands of parameters
};

inline constexpr int kMaxFullDimension = 200;

// The form that kAuto stands for; others stand for themselves.
CovarianceForm ResolveForm(CovarianceForm form, int dimension);

// Constants of CMA-ES for P parameters and populations of lambda. Numbers are those of N. Hansen's
// tutorial (arXiv 1604.00772), table 1.
struct StrategyParameters {
  int parents = 0;          // mu
  Eigen::VectorXd weights;  // (lambda) w_i, the first mu positive, the others <= 0
  double mu_eff = 0, c_sigma = 0, d_sigma = 0, c_c = 0, c_1 = 0, c_mu = 0;
  double expected_norm = 0;  // E||N(0, I)||
};

// kDiagonal: c_1 and c_mu times (P + 2) / 3 (R. Ros and N. Hansen, "A Simple Modification in
// CMA-ES Achieving Linear Time and Space Complexity", PPSN 2008). kLimitedMemory: c_sigma of I.
// Loshchilov, T. Glasmachers and H.-G. Beyer (arXiv 1705.06693). `form` is not kAuto.
StrategyParameters MakeStrategyParameters(CovarianceForm form, int dimension, int population);

// What a generation tells the model of the covariance.
struct CovarianceUpdate {
  const StrategyParameters& parameters;
  const Eigen::MatrixXd& z;  // (P x lambda) samples N(0, I)
  const Eigen::MatrixXd& y;  // (P x lambda) the same as N(0, C)
  const int* ranking;        // (lambda) candidates, best first
  const Eigen::VectorXd& path_c;
  const Eigen::VectorXd& step_z;  // sum of w_i z_i over the parents
  // Weight of the old C: 1 + c_1 delta(h_sigma) - c_1 - c_mu sum(w), Eq. 47.
  double decay;
  int generation;  // counting this one
};

// w_i of the candidate ranked i, for Eq. 47: Eq. 46 scales negative ones by P / ||C^(-1/2) y||^2,
// and ||C^(-1/2) y|| = ||z||.
double ScaledWeight(const CovarianceUpdate& update, int i);

}  // namespace downpour
