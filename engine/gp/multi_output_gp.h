// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "engine/gp/gp_model.h"
#include "engine/gp/hyperparameters.h"
#include "engine/gp/query_plan.h"

namespace downpour {

// A model of E outputs on shared inputs: one exact GP an output, and the plan by which its queries
// are answered within the tolerances. The plans hold them on probes like the data: the training
// inputs, and seeded points on the lines through pairs of these. Immutable after construction:
// const calls are thread-safe.
class MultiOutputGp {
 public:
  // One set of hyper-parameters an output. `threads` >= 1 OpenMP threads take the outputs side by
  // side; results do not depend on it. Throws InvalidInput as ExactGp and ChoosePlan do, or if the
  // sizes disagree.
  MultiOutputGp(const Dataset& data, std::span<const Hyperparameters> hyperparameters,
                const QueryPlanOptions& options, int threads);

  // With the hyper-parameters of FitHyperparameters(data, {}, {}, seed, 0, threads, stop).
  static MultiOutputGp Fit(const Dataset& data, const QueryPlanOptions& options, std::uint64_t seed,
                           int threads, const std::atomic<bool>* stop = nullptr);

  int n_points() const { return static_cast<int>(exact_.front().inputs().rows()); }
  int n_inputs() const { return static_cast<int>(exact_.front().inputs().cols()); }
  int n_outputs() const { return static_cast<int>(exact_.size()); }
  // One an output, as everything below.
  std::span<const ExactGp> exact() const { return exact_; }
  std::span<const QueryFactor> factors() const { return factors_; }
  // Their factors have been moved to factors().
  std::span<const OutputPlan> plans() const { return plans_; }

  // Means and, unless `variances` is empty, variances of B queries, all row-major: inputs B x D,
  // means and variances B x E, which alias nothing. Variances are latent (>= 0), with_noise adds
  // the noise variance. A row that is not finite gives NaN in its results. Without OpenBLAS a row's
  // bits depend on that row alone; with it, on its place in the batch too; never on `threads` >= 1.
  // Throws InvalidInput if a size is wrong. Allocates scratch.
  void Predict(std::span<const double> inputs, bool with_noise, int threads,
               std::span<double> means, std::span<double> variances) const;

  // Nanoseconds of one query of mean and variance by each plan (engine/gp/query_timing.h).
  std::vector<double> TimeQueries() const;

 private:
  struct Chunk;
  void PredictChunk(const Chunk& chunk) const;

  std::vector<ExactGp> exact_;
  std::vector<OutputPlan> plans_;
  std::vector<QueryFactor> factors_;
};

}  // namespace downpour
