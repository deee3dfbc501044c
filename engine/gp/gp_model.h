// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "engine/gp/hyperparameters.h"
#include "kernels/gp_query/gp_query.h"

namespace downpour {

// Exact GP of one output with a cached fp64 Cholesky factor (paper Eq. 4-6):
//   K = sigma_f^2 exp(-1/2 sum (Delta_d/l_d)^2) + sigma_n^2 I = L L^T,  alpha = K^-1 y.
// Immutable after construction: const calls are thread-safe.
class ExactGp {
 public:
  // inputs n x D, targets (n), n >= 1. Throws InvalidInput for sizes that disagree, non-finite data
  // or hyper-parameters outside [1e-150, 1e150]. When the factorisation fails, jitter of
  // 1e-10 sigma_f^2, times 10 at each further failure, is added to the diagonal; jitter() tells.
  // Throws InvalidInput when sigma_f^2 is not enough.
  ExactGp(const Eigen::MatrixXd& inputs, const Eigen::VectorXd& targets,
          const Hyperparameters& hyperparameters);
  // From row-major numbers: inputs n x n_inputs, targets (n).
  ExactGp(std::span<const double> inputs, int n_inputs, std::span<const double> targets,
          const Hyperparameters& hyperparameters);

  // This model with further points (k x D) and their targets (k), the hyper-parameters unchanged,
  // in O(n^2 (D + k)) instead of O(n^3): as if constructed from all points, to rounding. Constructs
  // it so where this model has jitter or the further points need some. Throws as the constructor.
  ExactGp Append(const Eigen::MatrixXd& inputs, const Eigen::VectorXd& targets) const;
  ExactGp Append(std::span<const double> inputs, int n_inputs,
                 std::span<const double> targets) const;

  const Hyperparameters& hyperparameters() const { return hyperparameters_; }
  const Eigen::MatrixXd& inputs() const { return inputs_; }
  const Eigen::MatrixXd& cholesky() const { return cholesky_; }  // L; the upper triangle is zero
  const Eigen::VectorXd& alpha() const { return alpha_; }
  double jitter() const { return jitter_; }
  double log_marginal_likelihood() const { return log_marginal_likelihood_; }

  // Mean and latent variance (>= 0) at one input (D), by a triangular solve. Allocates.
  void Predict(const Eigen::VectorXd& input, double* mean, double* variance) const;
  // With the noise variance, as of an observation, or without it.
  void Predict(std::span<const double> input, bool with_noise, double* mean,
               double* variance) const;

  // The posterior for GpQueryTile.
  GpFactor Pack() const;

 private:
  ExactGp() = default;
  ExactGp(const Dataset& data, const Hyperparameters& hyperparameters);
  void SolveAlpha();  // from targets_ and cholesky_, with the likelihood

  Hyperparameters hyperparameters_;
  Eigen::MatrixXd inputs_;
  Eigen::VectorXd targets_;
  Eigen::MatrixXd cholesky_;
  Eigen::VectorXd alpha_;
  double jitter_ = 0;
  double log_marginal_likelihood_ = 0;
};

// Options of hyper-parameter learning.
struct GpFitOptions {
  int restarts = 1;  // seeded starts besides the warm or default one; [0, 100]
  // Likelihoods a start may take (a line search under way is finished); [1, 100000].
  int max_evaluations = 200;
};

// What learning one output's hyper-parameters came to.
struct GpFit {
  Hyperparameters hyperparameters;
  double log_likelihood = 0;  // without the curb
  int evaluations = 0;        // of the likelihood, all starts
};

// Maximum-likelihood hyper-parameters of every output by L-BFGS on the logarithms, with PILCO's
// curb
//   sum_d ((log l_d - log std x_d)/log 100)^30 + ((log sigma_f - log sigma_n)/log 500)^30
// subtracted from the log likelihood. `warm_start` is empty or holds one entry an output (the last
// episode's optimum). The default start is l_d = std x_d, sigma_f = rms y (the std of differences
// about the prior mean, zero), sigma_n = rms y / 10. A constant input (or n = 1) counts as std 1;
// rms y is at least 1e-12, so that an output that is always zero has an answer, too. The search
// stays within l_d / std x_d in [1e-3, 1e3], sigma_f / rms y in [1e-4, 1e4], sigma_n / rms y in
// [1e-6, 1e2]. Starts are drawn from (seed, episode, first_output + output, start), so results do
// not depend on `threads`. Outputs x starts run in parallel on `threads` OpenMP threads; the
// highest penalised likelihood wins, ties go to the first start. Throws InvalidInput for empty or
// non-finite data, options out of range, a warm start that does not fit, or data so large that no
// likelihood is finite. `stop` (may be null) is looked at before every likelihood; once it is true,
// throws Interrupted.
std::vector<GpFit> FitHyperparameters(const Dataset& data,
                                      const std::vector<Hyperparameters>& warm_start,
                                      const GpFitOptions& options, std::uint64_t seed,
                                      std::uint32_t episode, int threads,
                                      const std::atomic<bool>* stop = nullptr,
                                      int first_output = 0);

}  // namespace downpour
