// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/planned_model.h"

#include <algorithm>
#include <numeric>
#include <utility>
#include <variant>

#include "engine/gp/query_timing.h"
#include "engine/parallel_for.h"
#include "engine/rollout/flush_subnormals.h"

namespace downpour {

PlannedModel::PlannedModel(std::vector<ExactGp> gps, const QueryPlanOptions& options, int threads)
    : gps_(std::move(gps)), options_(options), threads_(threads) {
  for (const ExactGp& gp : gps_) exact_factors_.push_back(gp.Pack());
  factors_ = exact_factors_;
  outputs_.resize(gps_.size());
  std::iota(outputs_.begin(), outputs_.end(), 0);
  plans_.resize(gps_.size());
  errors_.resize(gps_.size());
}

void PlannedModel::Plan(std::span<const int> outputs, const QueryPlanOptions& options) {
  ParallelFor(static_cast<int>(outputs.size()), threads_, [&](int i) {
    const int e = outputs[i];
    plans_[e] = ChoosePlan(gps_[e], probes_.leftCols(gps_[e].inputs().cols()), options);
    factors_[e] = plans_[e].factor;
    errors_[e] = plans_[e].probe_errors;
  });
}

std::vector<int> PlannedModel::Measure(std::span<const int> outputs,
                                       const Eigen::MatrixXd& inputs) {
  std::vector<PlanErrors> found(outputs.size());
  ParallelFor(static_cast<int>(outputs.size()), threads_, [&](int i) {
    const int e = outputs[i];
    found[i] = MeasurePlan(plans_[e], std::get<GpFactor>(exact_factors_[e]),
                           inputs.leftCols(gps_[e].inputs().cols()));
  });
  std::vector<int> failed;
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    const int e = outputs[i];
    errors_[e].variance = std::max(errors_[e].variance, found[i].variance);
    errors_[e].mean = std::max(errors_[e].mean, found[i].mean);
    const bool exact = !plans_[e].compressed && !plans_[e].single_precision;
    if (!exact && (found[i].variance > options_.variance_tolerance ||
                   found[i].mean > options_.mean_tolerance)) {
      failed.push_back(e);
    }
  }
  return failed;
}

void PlannedModel::Choose(Eigen::MatrixXd probes) {
  probes_ = std::move(probes);
  Plan(outputs_, options_);
}

int PlannedModel::Check(const Eigen::MatrixXd& inputs) {
  const std::vector<int> failed = Measure(outputs_, inputs);
  if (failed.empty()) return 0;
  Eigen::MatrixXd probes(probes_.rows() + inputs.rows(), inputs.cols());
  probes << probes_, inputs;
  probes_ = std::move(probes);
  Plan(failed, options_);
  // A plan looks at a subset of many probes: what fails still is answered exactly.
  Plan(Measure(failed, inputs), {.variance_tolerance = 0, .mean_tolerance = 0});
  return static_cast<int>(failed.size());
}

std::vector<double> PlannedModel::TimeQueries(bool flush_subnormals) const {
  const FlushSubnormals flush(flush_subnormals);
  return downpour::TimeQueries(factors_, probes_);
}

}  // namespace downpour
