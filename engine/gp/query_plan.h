// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>
#include <variant>

#include "engine/gp/blas_query.h"
#include "engine/gp/gp_model.h"
#include "kernels/gp_query/gp_query.h"

namespace downpour {

// What answers queries.
enum class QueryBackend {
  kFused,  // the fused kernel, by plan
  kBlas,   // OpenBLAS, exact fp64 whatever the tolerances
};

// The backends' names to users and in files, in their order.
inline constexpr std::array kQueryBackendNames = {"fused", "blas"};
inline const char* QueryBackendName(QueryBackend backend) {
  return kQueryBackendNames.at(static_cast<std::size_t>(backend));
}

// Largest error of a query that a plan may make, against the exact fp64 posterior.
struct QueryPlanOptions {
  // |variance error| / (variance + noise variance); [0, 1], 0: exact fp64.
  double variance_tolerance = 0.02;
  // |mean error| / sqrt(variance + noise variance); [0, 1], 0: exact fp64.
  double mean_tolerance = 0.05;
  QueryBackend backend = QueryBackend::kFused;
};

// Worst errors over some inputs, in the units of QueryPlanOptions; infinite where an answer is NaN.
struct PlanErrors {
  double variance = 0;
  double mean = 0;
};

// A posterior for the fused kernel in either precision, or for OpenBLAS.
using QueryFactor = std::variant<GpFactor, GpFactor32, BlasFactor>;

// Doubles of scratch that queries by any of the factors need, with OpenBLAS for `blas_tiles` tiles
// at once.
std::size_t QueryScratch(std::span<const QueryFactor> factors, int blas_tiles);

// How one output's queries are answered.
struct OutputPlan {
  bool compressed = false;
  bool single_precision = false;
  int n = 0;                 // training points
  int points = 0;            // points of the factor; n unless compressed
  double tau = 0;            // of the compression (Compression::PointsFor), 0 unless compressed
  PlanErrors probe_errors;   // measured on the probes; 0 for exact fp64, by BLAS too
  double relative_cost = 1;  // modelled cost of a query, exact fp64 = 1
  QueryFactor factor;

  QueryBackend backend() const {
    return std::holds_alternative<BlasFactor>(factor) ? QueryBackend::kBlas : QueryBackend::kFused;
  }
};

// Modelled cost of one query of mean and variance by m points, in fp64 FMA slots a lane.
double QueryCost(int points, int dim, bool single_precision);

// The cheapest (QueryCost) of {exact, compressed} x {fp64, fp32} whose errors on the probes are at
// most half of both tolerances, so that errors on other inputs of the same kind stay under the
// tolerances themselves: with the learner's probes, the worst of 840 outputs of 240 cart-pole and
// pendulum models on 100,000 fresh inputs each was 0.91 of the variance's tolerance and 0.78 of the
// mean's (bench/plan_study). Compressions with tau from 1 down to 1e-6 are tried, filled up to
// whole blocks of the kernel's rows.
//   probes   rows x D: training inputs and inputs met by rollouts, whose spread counts; of more
//            than 8192 every k-th is used. No probes: exact fp64.
// With the BLAS backend the plan is exact fp64 and nothing is measured.
// Throws InvalidInput for options out of range, probes of another dimension or not finite ones.
// Deterministic, thread-safe, allocates; O(n^3) and some 10 ms an output at n = 320.
OutputPlan ChoosePlan(const ExactGp& exact, const Eigen::MatrixXd& probes,
                      const QueryPlanOptions& options);
// Of row-major probes with n_inputs columns.
OutputPlan ChoosePlan(const ExactGp& exact, std::span<const double> probes, int n_inputs,
                      const QueryPlanOptions& options);

// Worst errors of a plan's factor on `inputs` (rows x D), all of them; `exact` is ExactGp::Pack()
// of the model. For the check during a search: where they are above the tolerances, choose again
// with these inputs among the probes. Throws as ChoosePlan. Thread-safe, allocates scratch only.
PlanErrors MeasurePlan(const OutputPlan& plan, const GpFactor& exact,
                       const Eigen::MatrixXd& inputs);
PlanErrors MeasurePlan(const OutputPlan& plan, const GpFactor& exact,
                       std::span<const double> inputs, int n_inputs);

}  // namespace downpour
