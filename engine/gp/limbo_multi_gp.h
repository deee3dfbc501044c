// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <tuple>
#include <vector>

#include "engine/gp/multi_output_gp.h"

namespace downpour {

// What limbo takes from its Params and template arguments.
struct LimboMultiGpOptions {
  // Before optimize_hyperparams, for every output and input dimension: limbo's defaults.
  double lengthscale = 1;
  double signal_std = 1;   // sigma_sq = signal_std^2
  double noise_std = 0.1;  // noise = noise_std^2
  // Tolerances of 0 are exact double precision, as limbo is; larger ones are faster (query_plan.h).
  QueryPlanOptions plan = {.variance_tolerance = 0, .mean_tolerance = 0};
  std::uint64_t seed = 0;  // of the starts of optimize_hyperparams
  int threads = 1;         // never changes a result
};

// MultiOutputGp in the calling shape of limbo's model::MultiGP (github.com/resibots/limbo,
// src/limbo/model/multi_gp.hpp) with kernel::SquaredExpARD and mean::NullFunction, for programs
// that are written for that one; names are limbo's. Vectors hold an entry an input (D) or output
// (E). As there, `sigma` is the VARIANCE of an observation, noise included.
//
// What differs: bad input throws InvalidInput where limbo asserts; add_sample factorises anew, in
// O(n^3); hyper-parameters are learnt as FitHyperparameters does, and kept by later calls of
// compute; there are neither gp_models() nor archives. Batches of queries are query_batch: by the
// row a fraction of the time of query. Const calls are thread-safe. All calls allocate.
class LimboMultiGp {
 public:
  LimboMultiGp() = default;
  explicit LimboMultiGp(const LimboMultiGpOptions& options) : options_(options) {}
  LimboMultiGp(int dim_in, int dim_out, const LimboMultiGpOptions& options = {});

  // The model of n samples (D) and their observations (E). With compute_kernel = false it only
  // keeps them, for optimize_hyperparams or recompute to come.
  void compute(const std::vector<Eigen::VectorXd>& samples,
               const std::vector<Eigen::VectorXd>& observations, bool compute_kernel = true);
  // Learns the hyper-parameters from the data, and the model with them.
  void optimize_hyperparams();
  void add_sample(const Eigen::VectorXd& sample, const Eigen::VectorXd& observation);
  void recompute();

  // Mean and variance (E each) at v (D). Before there is data: 0 and the prior's variance.
  std::tuple<Eigen::VectorXd, Eigen::VectorXd> query(const Eigen::VectorXd& v) const;
  Eigen::VectorXd mu(const Eigen::VectorXd& v) const;
  Eigen::VectorXd sigma(const Eigen::VectorXd& v) const;
  // The same for every row of v (B x D): B x E each.
  std::tuple<Eigen::MatrixXd, Eigen::MatrixXd> query_batch(const Eigen::MatrixXd& v) const;

  int dim_in() const { return dim_in_; }    // -1 before it is known
  int dim_out() const { return dim_out_; }  // -1 before it is known
  int nb_samples() const { return static_cast<int>(samples_.size()); }
  const std::vector<Eigen::VectorXd>& samples() const { return samples_; }
  const std::vector<Eigen::VectorXd>& observations() const { return observations_; }
  Eigen::MatrixXd observations_matrix() const;  // n x E
  Eigen::VectorXd mean_observation() const;     // zero before there is data

  // Not limbo's: one an output; and the model, null before there is one.
  const std::vector<Hyperparameters>& hyperparameters() const { return hyperparameters_; }
  void set_hyperparameters(std::vector<Hyperparameters> hyperparameters);
  const std::shared_ptr<const MultiOutputGp>& model() const { return model_; }

 private:
  void SetDimensions(Eigen::Index dim_in, Eigen::Index dim_out);
  Dataset Data() const;

  LimboMultiGpOptions options_;
  int dim_in_ = -1, dim_out_ = -1;
  std::vector<Eigen::VectorXd> samples_, observations_;
  std::vector<Hyperparameters> hyperparameters_;  // (E)
  std::shared_ptr<const MultiOutputGp> model_;
};

}  // namespace downpour
