// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/query_plan.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "engine/gp/checks.h"
#include "engine/gp/compression.h"

namespace downpour {
namespace {

constexpr int kMaxProbes = 8192;
// Probes may use half of the tolerance.
constexpr double kMargin = 0.5;
// Half decades: neighbours differ by about one block of rows at n = 320.
constexpr double kLadder[] = {1,    0.3,  0.1,  0.03, 0.01, 0.003, 1e-3,
                              3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6};

std::string Text(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%g", value);
  return text;
}

void CheckTolerance(const char* name, double value) {
  if (value >= 0 && value <= 1) return;
  throw InvalidInput("query plan: " + std::string(name) + " is " + Text(value) +
                     ", must be in [0, 1]");
}

// Inputs laid out in tiles, D x kTileLanes each; the last one's free lanes are zero.
class Tiles {
 public:
  Tiles(const Eigen::MatrixXd& inputs, int dim, int max_rows)
      : dim_(dim), n_(static_cast<int>(std::min<Eigen::Index>(inputs.rows(), max_rows))) {
    if (n_ > 0 && inputs.cols() != dim) {
      throw InvalidInput("query plan: inputs have " + std::to_string(inputs.cols()) +
                         " columns, must be " + std::to_string(dim));
    }
    values_.resize(static_cast<std::size_t>(count()) * dim * kTileLanes);
    for (int i = 0; i < n_; ++i) {
      const Eigen::Index row = inputs.rows() * i / n_;
      for (int d = 0; d < dim; ++d) {
        const double value = inputs(row, d);
        if (!std::isfinite(value)) {
          throw InvalidInput("query plan: input " + std::to_string(row) + ", column " +
                             std::to_string(d) + " is " + Text(value) + ", must be finite");
        }
        values_[(i / kTileLanes * dim + d) * kTileLanes + i % kTileLanes] = value;
      }
    }
  }

  int n() const { return n_; }
  int count() const { return (n_ + kTileLanes - 1) / kTileLanes; }
  int lanes(int tile) const { return std::min(kTileLanes, n_ - tile * kTileLanes); }
  const double* x(int tile) const {
    return values_.data() + static_cast<std::size_t>(tile) * dim_ * kTileLanes;
  }

 private:
  int dim_, n_;
  AlignedVector<double> values_;
};

// Means and variances of all tiles, count() x kTileLanes each.
struct Answers {
  AlignedVector<double> mean, variance;
};

Answers Ask(const GpFactor& factor, const Tiles& tiles) {
  const std::size_t size = static_cast<std::size_t>(tiles.count()) * kTileLanes;
  Answers answers{AlignedVector<double>(size), AlignedVector<double>(size)};
  AlignedVector<char> scratch(GpQueryScratchBytes(factor));
  for (int t = 0; t < tiles.count(); ++t) {
    GpQueryTile(factor, tiles.lanes(t), tiles.x(t), scratch.data(),
                answers.mean.data() + t * kTileLanes, answers.variance.data() + t * kTileLanes);
  }
  return answers;
}

bool Within(const PlanErrors& errors, const PlanErrors& tolerance) {
  return errors.variance <= tolerance.variance && errors.mean <= tolerance.mean;
}

// Worst errors over the tiles; gives up after the first tile above the tolerance.
template <typename Factor>
PlanErrors Compare(const Factor& factor, const Tiles& tiles, const Answers& exact,
                   const PlanErrors& tolerance) {
  AlignedVector<char> scratch(GpQueryScratchBytes(factor));
  AlignedVector<double> mean(kTileLanes), variance(kTileLanes);
  const auto raise = [](double error, double* worst) {
    if (!(error <= *worst)) *worst = std::isnan(error) ? HUGE_VAL : error;
  };
  PlanErrors worst;
  for (int t = 0; t < tiles.count() && Within(worst, tolerance); ++t) {
    GpQueryTile(factor, tiles.lanes(t), tiles.x(t), scratch.data(), mean.data(), variance.data());
    for (int lane = 0; lane < tiles.lanes(t); ++lane) {
      const std::size_t at = static_cast<std::size_t>(t) * kTileLanes + lane;
      const double predictive = exact.variance[at] + factor.noise_variance;
      raise(std::abs(variance[lane] - exact.variance[at]) / predictive, &worst.variance);
      raise(std::abs(mean[lane] - exact.mean[at]) / std::sqrt(predictive), &worst.mean);
    }
  }
  return worst;
}

// One way of answering, before its factor is made. points = 0: exact.
struct Candidate {
  int points = 0;
  double tau = 0;
  bool single_precision = false;
  double cost = 0;
};

// Cheapest first; the last is exact fp64. What costs more than that is left out.
std::vector<Candidate> Candidates(const Compression& compression, int n, int dim) {
  std::vector<Candidate> candidates;
  for (const double tau : kLadder) {
    // Rows up to the next whole block cost nothing.
    const int blocks = (compression.PointsFor(tau) + kRowBlock - 1) / kRowBlock;
    const int points = std::min(blocks * kRowBlock, compression.size());
    if (!candidates.empty() && candidates.back().points == points) continue;
    for (const bool single_precision : {false, true}) {
      candidates.push_back(
          {points, tau, single_precision, QueryCost(points, dim, single_precision)});
    }
  }
  candidates.push_back({0, 0, true, QueryCost(n, dim, true)});
  const double exact_cost = QueryCost(n, dim, false);
  std::erase_if(candidates, [=](const Candidate& c) { return c.cost >= exact_cost; });
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.cost < b.cost; });
  candidates.push_back({0, 0, false, exact_cost});
  return candidates;
}

}  // namespace

double QueryCost(int points, int dim, bool single_precision) {
  const double m = (points + kRowBlock - 1) / kRowBlock * kRowBlock;
  // The triangle's FMAs; a covariance by measurement (within 7 % for D = 4, 6, m = 40 ... 1280).
  const double cost = m * (m + kRowBlock) / 2 + m * (2 * dim + 16);
  return single_precision ? (cost + m * kRowBlock) / 2 : cost;  // with deflation
}

std::size_t QueryScratch(std::span<const QueryFactor> factors, int blas_tiles) {
  std::size_t bytes = 0;
  for (const QueryFactor& factor : factors) {
    if (const auto* blas = std::get_if<BlasFactor>(&factor)) {
      bytes = std::max(bytes, BlasQueryScratchBytes(*blas, blas_tiles));
    } else {
      std::visit([&](const auto& f) { bytes = std::max(bytes, GpQueryScratchBytes(f)); }, factor);
    }
  }
  return (bytes + sizeof(double) - 1) / sizeof(double);
}

OutputPlan ChoosePlan(const ExactGp& exact, const Eigen::MatrixXd& probes,
                      const QueryPlanOptions& options) {
  CheckTolerance("variance_tolerance", options.variance_tolerance);
  CheckTolerance("mean_tolerance", options.mean_tolerance);
  const int n = static_cast<int>(exact.inputs().rows());
  const int dim = static_cast<int>(exact.inputs().cols());
  const Tiles tiles(probes, dim, kMaxProbes);
  OutputPlan plan{.n = n, .points = n};
  if (options.backend == QueryBackend::kBlas) {
    plan.factor = MakeBlasFactor(exact);
    return plan;
  }
  plan.factor = exact.Pack();
  const PlanErrors tolerance{kMargin * options.variance_tolerance,
                             kMargin * options.mean_tolerance};
  if (tolerance.variance == 0 || tolerance.mean == 0 || tiles.n() == 0) return plan;

  const Answers answers = Ask(std::get<GpFactor>(plan.factor), tiles);
  const Compression compression(exact, *std::rbegin(kLadder));
  for (const Candidate& c : Candidates(compression, n, dim)) {
    if (c.points == 0 && !c.single_precision) break;
    const ReducedPosterior posterior =
        c.points == 0 ? ExactPosterior(exact) : compression.First(c.points);
    QueryFactor factor;
    if (c.single_precision) {
      factor = PackPosterior<float>(exact, posterior);
    } else {
      factor = PackPosterior<double>(exact, posterior);
    }
    const PlanErrors errors =
        std::visit([&](const auto& f) { return Compare(f, tiles, answers, tolerance); }, factor);
    if (!Within(errors, tolerance)) continue;
    return {.compressed = c.points != 0,
            .single_precision = c.single_precision,
            .n = n,
            .points = c.points == 0 ? n : c.points,
            .tau = c.tau,
            .probe_errors = errors,
            .relative_cost = c.cost / QueryCost(n, dim, false),
            .factor = std::move(factor)};
  }
  return plan;
}

OutputPlan ChoosePlan(const ExactGp& exact, std::span<const double> probes, int n_inputs,
                      const QueryPlanOptions& options) {
  return ChoosePlan(exact, MatrixOfRows(probes, n_inputs, "probes"), options);
}

PlanErrors MeasurePlan(const OutputPlan& plan, const GpFactor& exact,
                       const Eigen::MatrixXd& inputs) {
  const Tiles tiles(inputs, exact.dim, static_cast<int>(inputs.rows()));
  const PlanErrors unlimited{HUGE_VAL, HUGE_VAL};
  const Answers answers = Ask(exact, tiles);
  return std::visit([&](const auto& f) { return Compare(f, tiles, answers, unlimited); },
                    plan.factor);
}

PlanErrors MeasurePlan(const OutputPlan& plan, const GpFactor& exact,
                       std::span<const double> inputs, int n_inputs) {
  return MeasurePlan(plan, exact, MatrixOfRows(inputs, n_inputs, "inputs"));
}

}  // namespace downpour
