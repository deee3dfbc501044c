// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/planned_model.h"

#include <algorithm>
#include <chrono>
#include <limits>
#include <numeric>
#include <utility>
#include <variant>

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
  using Clock = std::chrono::steady_clock;
  constexpr std::chrono::milliseconds kEnough(1);
  AlignedVector<double> x(static_cast<std::size_t>(probes_.cols()) * kTileLanes);
  for (Eigen::Index d = 0; d < probes_.cols(); ++d) {
    for (int lane = 0; lane < kTileLanes; ++lane) {
      x[d * kTileLanes + lane] = probes_(lane * probes_.rows() / kTileLanes, d);
    }
  }
  std::size_t bytes = 0;
  for (const QueryFactor& factor : factors_) {
    std::visit([&](const auto& f) { bytes = std::max(bytes, GpQueryScratchBytes(f)); }, factor);
  }
  AlignedVector<char> scratch(bytes);
  AlignedVector<double> means(kTileLanes), variances(kTileLanes);
  std::vector<double> best(factors_.size(), std::numeric_limits<double>::infinity());
  const FlushSubnormals flush(flush_subnormals);
  const Clock::time_point first = Clock::now();
  for (int round = 0; round < 2 || Clock::now() - first < kEnough; ++round) {
    for (std::size_t e = 0; e < factors_.size(); ++e) {
      const Clock::time_point start = Clock::now();
      std::visit(
          [&](const auto& f) {
            GpQueryTile(f, kTileLanes, x.data(), scratch.data(), means.data(), variances.data());
          },
          factors_[e]);
      const std::chrono::duration<double, std::nano> elapsed = Clock::now() - start;
      best[e] = std::min(best[e], elapsed.count() / kTileLanes);
    }
  }
  return best;
}

}  // namespace downpour
