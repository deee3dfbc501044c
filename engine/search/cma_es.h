// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <variant>
#include <vector>

#include "engine/search/diagonal_covariance.h"
#include "engine/search/fitness_history.h"
#include "engine/search/full_covariance.h"
#include "engine/search/learning_rate.h"
#include "engine/search/limited_memory.h"
#include "engine/search/strategy_parameters.h"
#include "kernels/philox/philox.h"

namespace downpour {

// Tolerances of the stopping criteria, with the defaults of Hansen's tutorial, appendix B.3.
struct CmaEsTolerances {
  double hist_fun = 1e-12;      // TolHistFun: span of the costs; absolute
  double x = 1e-12;             // TolX: standard deviation of every coordinate / initial sigma
  double x_up = 1e4;            // TolXUp: largest standard deviation of any axis / initial sigma
  double condition_cov = 1e14;  // ConditionCov: condition number of C
  // MaxEvaluations: costs told, lambda a generation
  std::int64_t max_evaluations = std::numeric_limits<std::int64_t>::max();
};

struct CmaEsOptions {
  CmaEsTolerances tolerances;
  CovarianceForm covariance = CovarianceForm::kFull;
  // Learning rates adapt to the signal-to-noise ratio (LRA-CMA-ES, see AdaptiveRate), at the price
  // of an eigendecomposition a generation. Not with limited memory.
  bool adapt_rates = false;
};

// Active CMA-ES, ask and tell, MINIMISING a cost over R^P, after N. Hansen, "The CMA Evolution
// Strategy: A Tutorial" (2016, arXiv 1604.00772), with its default strategy parameters. What is
// adapted beside mean and step size is CmaEsOptions::covariance; see FullCovariance,
// DiagonalCovariance and LimitedMemory.
//
// The candidates of a generation depend only on the key given to Ask and on what was told before.
// Ask and Tell do not allocate, except that the history of Tell grows and that adapted rates take
// scratch. With the full matrix each takes O(P^2 lambda), and every few generations Tell adds the
// O(P^3) eigendecomposition of C; the other forms are linear in P. BLAS runs on the calling thread
// only. Different objects may be used by different threads at once.
class CmaEs {
 public:
  // Starts at `mean` (P >= 1) with step size `sigma` > 0 and C = I; population lambda >= 2.
  // Callers check their options; finite input is assumed here. Throws InvalidInput if rates shall
  // adapt with limited memory.
  CmaEs(std::span<const double> mean, double sigma, int population,
        const CmaEsOptions& options = {});

  // All that the future depends on, as numbers, after any Tell. An object that is restored from
  // them, with the tolerances of the one that was saved, goes on with the same bits; a population
  // that had been asked for but not told must be asked for again.
  std::vector<double> Save() const;
  // Throws InvalidInput if `state` is no list that Save wrote.
  static CmaEs Restore(std::span<const double> state, const CmaEsTolerances& tolerances = {});

  // 4 + 3 ln P, Eq. 48 before it is rounded down.
  static double DefaultPopulation(int dimension);

  int dimension() const { return dimension_; }
  int population() const { return population_; }
  int generation() const { return generation_; }       // generations told so far
  CovarianceForm covariance() const { return form_; }  // never kAuto
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

  // The criterion met by the last Tell: EqualFunValues, TolHistFun, TolX, TolXUp,
  // ConditionCov, NoEffectAxis, NoEffectCoord, Stagnation or MaxEvaluations, the first in this
  // order if several are; empty while the run should go on.
  std::string_view stop() const { return stop_; }

 private:
  using Covariance = std::variant<FullCovariance, DiagonalCovariance, LimitedMemory>;
  struct AdaptiveRates {
    AdaptiveRate mean, covariance;
  };

  Covariance MakeCovariance() const;
  void UpdateDistribution(const CovarianceUpdate& update);
  double StepSizeFactor() const;
  std::string_view FindStop();
  bool HasNoEffectAxis() const;
  bool HasNoEffectCoord() const;
  bool IsBelowTolX() const;
  template <typename Archive>
  void Visit(Archive& archive);

  int dimension_;
  int population_;
  CmaEsTolerances tolerances_;
  CovarianceForm form_;
  StrategyParameters parameters_;
  double initial_sigma_;

  // State.
  int generation_ = 0;
  double sigma_;
  std::string_view stop_;
  Eigen::VectorXd mean_, path_sigma_, path_c_;
  Covariance covariance_;
  std::optional<AdaptiveRates> rates_;
  FitnessHistory history_;

  // Scratch.
  Eigen::MatrixXd z_, y_;  // (P x lambda) N(0, I) and N(0, C) samples of this generation
  Eigen::VectorXd step_, step_z_;
  std::vector<double> costs_;
  std::vector<int> ranking_;
};

}  // namespace downpour
