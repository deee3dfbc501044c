// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "engine/errors.h"
#include "engine/gp/multi_output_gp.h"
#include "engine/rollout/model_evaluator.h"
#include "engine/search/minimise.h"

// The calls that take spans, with Eigen's types instead: a row is a query, a parameter vector or a
// candidate. Results and errors are those of the calls. Other expressions than row-major
// matrices are copied.

namespace downpour {

// A matrix in the layout of the spans.
using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Posterior of B queries, a row each.
struct Prediction {
  RowMajorMatrix means;      // B x E
  RowMajorMatrix variances;  // B x E
};

// MultiOutputGp::Predict of inputs (B x D). Throws InvalidInput unless there are D columns.
// Thread-safe, allocates.
inline Prediction Predict(const MultiOutputGp& gp, const RowMajorMatrix& inputs, bool with_noise,
                          int threads = 1) {
  if (inputs.cols() != gp.n_inputs()) {
    throw InvalidInput("GP: queries of " + std::to_string(inputs.cols()) + " inputs, must be of " +
                       std::to_string(gp.n_inputs()));
  }
  Prediction prediction;
  prediction.means.resize(inputs.rows(), gp.n_outputs());
  prediction.variances.resize(inputs.rows(), gp.n_outputs());
  const auto size = static_cast<std::size_t>(prediction.means.size());
  gp.Predict({inputs.data(), static_cast<std::size_t>(inputs.size())}, with_noise, threads,
             {prediction.means.data(), size}, {prediction.variances.data(), size});
  return prediction;
}

// ModelEvaluator::Evaluate of parameters (n x P): returns n x rollouts. Thread-safe, allocates.
inline RowMajorMatrix Evaluate(const ModelEvaluator& evaluator, const RowMajorMatrix& parameters,
                               std::uint64_t seed) {
  RowMajorMatrix returns(parameters.rows(), evaluator.rollouts());
  evaluator.Evaluate({parameters.data(), static_cast<std::size_t>(parameters.size())},
                     static_cast<int>(parameters.cols()), seed,
                     {returns.data(), static_cast<std::size_t>(returns.size())});
  return returns;
}

// Minimiser::Ask: candidates lambda x P, valid until the next call of the minimiser.
inline Eigen::Map<const RowMajorMatrix> Ask(Minimiser* minimiser) {
  const std::span<const double> candidates = minimiser->Ask();
  return {candidates.data(), minimiser->population(), minimiser->dimension()};
}

// Minimiser::Tell of costs (lambda).
inline void Tell(Minimiser* minimiser, const Eigen::VectorXd& costs) {
  minimiser->Tell({costs.data(), static_cast<std::size_t>(costs.size())});
}

}  // namespace downpour
