// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "engine/gp/gp_model.h"
#include "engine/gp/query_plan.h"

namespace downpour {

// A learnt model, one exact GP an output, and the plan by which rollouts query it. The plan holds
// its tolerances on the probes: inputs like those that rollouts meet (rows x D). An output of fewer
// inputs, as a learnt reward, sees the leading columns. Not thread-safe.
class PlannedModel {
 public:
  // `threads` OpenMP threads plan outputs side by side; results do not depend on it. Throws as
  // ChoosePlan does.
  PlannedModel(std::vector<ExactGp> gps, const QueryPlanOptions& options, int threads);

  // The exact posteriors, to find probes with.
  std::span<const QueryFactor> exact_factors() const { return exact_factors_; }

  // Chooses every output's plan. probes: rows x D.
  void Choose(Eigen::MatrixXd probes);

  // Measures the plans on inputs that were met (rows x D). Outputs whose errors are above the
  // tolerances are planned again with these inputs among the probes, or answered exactly if that
  // does not help; returns how many.
  int Check(const Eigen::MatrixXd& inputs);

  // After Choose: factors and plans, one an output. They stay until the next Choose or Check.
  std::span<const QueryFactor> factors() const { return factors_; }
  const std::vector<OutputPlan>& plans() const { return plans_; }
  // Worst errors of each output's present plan in all checks and probes so far.
  const std::vector<PlanErrors>& errors() const { return errors_; }

  // Nanoseconds of one query by each output's present plan, on probes (engine/gp/query_timing.h).
  // Rollouts flush subnormal numbers if there is a prior. After Choose, with a probe at least.
  std::vector<double> TimeQueries(bool flush_subnormals = false) const;

 private:
  void Plan(std::span<const int> outputs, const QueryPlanOptions& options);
  // Adds to the errors of `outputs`; returns those above the tolerances.
  std::vector<int> Measure(std::span<const int> outputs, const Eigen::MatrixXd& inputs);

  std::vector<ExactGp> gps_;
  QueryPlanOptions options_;
  int threads_;
  std::vector<int> outputs_;  // 0, 1, ... E - 1
  Eigen::MatrixXd probes_;
  std::vector<QueryFactor> exact_factors_, factors_;
  std::vector<OutputPlan> plans_;
  std::vector<PlanErrors> errors_;
};

}  // namespace downpour
