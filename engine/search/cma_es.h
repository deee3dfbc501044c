// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "engine/search/fitness_history.h"
#include "kernels/philox/philox.h"

namespace downpour {

// Tolerances of the stopping criteria, with the defaults of Hansen's tutorial, appendix B.3.
struct CmaEsTolerances {
  double hist_fun = 1e-12;      // TolHistFun: span of the costs; absolute
  double x = 1e-12;             // TolX: standard deviation of every coordinate / initial sigma
  double x_up = 1e4;            // TolXUp: largest standard deviation of any axis / initial sigma
  double condition_cov = 1e14;  // ConditionCov: condition number of C
};

// Active CMA-ES, ask and tell, MINIMISING a cost over R^P, after N. Hansen, "The CMA Evolution
// Strategy: A Tutorial" (2016, arXiv 1604.00772), with its default strategy parameters.
//
// The candidates of a generation depend only on the key given to Ask and on what was told before.
// Ask and Tell do not allocate, except that the history of Tell grows; each takes O(P^2 lambda),
// and every few generations Tell adds the O(P^3) eigendecomposition of C. BLAS runs on the calling
// thread only. Different objects may be used by different threads at once.
class CmaEs {
 public:
  // Starts at `mean` (P >= 1) with step size `sigma` > 0 and C = I; population lambda >= 2.
  // Callers check their options; finite input is assumed here.
  CmaEs(std::span<const double> mean, double sigma, int population,
        const CmaEsTolerances& tolerances = {});

  // lambda = 4 + floor(3 ln P), Eq. 48.
  static int DefaultPopulation(int dimension);

  int dimension() const { return dimension_; }
  int population() const { return population_; }
  int generation() const { return generation_; }  // generations told so far
  double sigma() const { return sigma_; }
  std::span<const double> mean() const { return {mean_.data(), static_cast<size_t>(dimension_)}; }

  // Writes a new population (lambda x P, row-major). Candidate c uses the normal numbers of `key`
  // at counter1 = c.
  void Ask(StreamKey key, std::span<double> candidates);

  // Updates the distribution from the costs (lambda) of the candidates of the last Ask; NaN counts
  // as +infinity. Ties are broken by the index.
  void Tell(std::span<const double> costs);
  // As above, but ranked by the caller: `ranking` (lambda) lists the candidates, best first. The
  // costs then only serve the stopping criteria.
  void Tell(std::span<const double> costs, std::span<const int> ranking);

  // Multiplies sigma, as uncertainty handling does.
  void ScaleSigma(double factor) { sigma_ *= factor; }

  // The criterion met by the last Tell: TolHistFun, EqualFunValues, TolX, TolXUp, Stagnation,
  // ConditionCov, NoEffectAxis or NoEffectCoord; empty while the run should go on.
  std::string_view stop() const { return stop_; }

 private:
  void SetStrategyParameters();
  void UpdateCovariance(std::span<const int> ranking, bool h_sigma);
  void UpdateEigensystem();
  std::string_view FindStop();
  bool HasNoEffectAxis() const;
  bool HasNoEffectCoord() const;
  bool IsBelowTolX() const;

  int dimension_;
  int population_;
  CmaEsTolerances tolerances_;
  double initial_sigma_;

  // Strategy parameters, Eq. 49-58.
  int parents_;              // mu
  Eigen::VectorXd weights_;  // (lambda) w_i, the first mu positive, the others <= 0
  double mu_eff_, c_sigma_, d_sigma_, c_c_, c_1_, c_mu_;
  double expected_norm_;  // E||N(0, I)||
  int eigen_interval_;    // generations between eigendecompositions

  // State.
  int generation_ = 0;
  int eigen_generation_ = 0;
  double sigma_;
  double condition_ = 1;
  std::string_view stop_;
  Eigen::VectorXd mean_, path_sigma_, path_c_;
  Eigen::MatrixXd covariance_;  // C, lower triangle
  Eigen::MatrixXd axes_;        // B, columns are eigenvectors of C as of eigen_generation_
  Eigen::VectorXd lengths_;     // D, square roots of the eigenvalues
  Eigen::MatrixXd root_;        // C^(1/2) = B D B^T, lower triangle
  FitnessHistory history_;

  // Scratch.
  Eigen::MatrixXd z_, y_;        // (P x lambda) N(0, I) and N(0, C) samples of this generation
  Eigen::MatrixXd selected_;     // (P x (lambda + 1)) weighted steps of the covariance update
  Eigen::MatrixXd scaled_axes_;  // B D^(1/2)
  Eigen::VectorXd step_, step_z_;
  std::vector<double> costs_;
  std::vector<int> ranking_;
  std::vector<double> work_;
  std::vector<int> integer_work_;
};

}  // namespace downpour
