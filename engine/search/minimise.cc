// SPDX-License-Identifier: Apache-2.0
#include "engine/search/minimise.h"

#include <cmath>
#include <cstddef>
#include <sstream>
#include <utility>

#include "engine/errors.h"

namespace downpour {
namespace {

void Check(bool allowed, const std::string& name, double value, const std::string& wanted) {
  if (allowed) return;
  std::ostringstream message;
  message << "Minimise: " << name << " = " << value << ": must be " << wanted;
  throw InvalidInput(message.str());
}

void CheckOptions(const MinimiseOptions& o) {
  const std::size_t n = o.lower.size();
  Check(n > 0, "lower.size()", static_cast<double>(n), "at least 1");
  Check(o.upper.size() == n, "upper.size()", static_cast<double>(o.upper.size()),
        "that of lower, " + std::to_string(n));
  for (std::size_t i = 0; i < n; ++i) {
    std::string at = std::to_string(i);
    at = '[' + at + ']';
    Check(std::isfinite(o.lower[i]), "lower" + at, o.lower[i], "finite");
    Check(std::isfinite(o.upper[i]) && o.upper[i] > o.lower[i], "upper" + at, o.upper[i],
          "finite and above lower" + at);
  }
  Check(o.start.empty() || o.start.size() == n, "start.size()", static_cast<double>(o.start.size()),
        "0 or that of lower, " + std::to_string(n));
  for (std::size_t i = 0; i < o.start.size(); ++i) {
    const double x = o.start[i];
    const std::string at = "start[" + std::to_string(i) + ']';
    Check(std::isfinite(x), at, x, "finite");
    Check(!o.bounded || (x >= o.lower[i] && x <= o.upper[i]), at, x, "between lower and upper");
  }
  Check(std::isfinite(o.sigma) && o.sigma > 0, "sigma", o.sigma, "finite and > 0");
  Check(o.population == 0 || o.population >= 2, "population", o.population, "0 or at least 2");
  Check(std::isfinite(o.restart_decades) && o.restart_decades >= 0, "restart_decades",
        o.restart_decades, "finite and >= 0");
  Check(o.evaluations >= 1, "evaluations", static_cast<double>(o.evaluations), "at least 1");
}

constexpr int kMaxPopulation = 1 << 20;

// Lambda of the first run, before it is rounded down; checks the options.
double FirstPopulation(const MinimiseOptions& options) {
  CheckOptions(options);
  return options.population > 0 ? options.population
                                : CmaEs::DefaultPopulation(static_cast<int>(options.lower.size()));
}

}  // namespace

Minimiser::Minimiser(MinimiseOptions options)
    : options_(std::move(options)),
      scheduler_(options_.restarts, FirstPopulation(options_), kMaxPopulation, options_.sigma,
                 options_.restart_decades) {
  for (int i = 0; options_.bounded && i < dimension(); ++i) {
    boxes_.emplace_back(options_.lower[i], options_.upper[i]);
  }
  plan_ = scheduler_.First(options_.sigma);
  StartRun();
  Advance();
}

StreamKey Minimiser::RunKey(int run) const {
  return DeriveKey(options_.seed, StreamPurpose::kSearchRestart, {static_cast<std::uint32_t>(run)});
}

void Minimiser::StartRun() {
  std::vector<double> mean(dimension());
  FillUniforms(RunKey(plan_.run), 1, mean.data(), mean.size());
  for (int i = 0; i < dimension(); ++i) {
    mean[i] = options_.lower[i] + (options_.upper[i] - options_.lower[i]) * mean[i];
  }
  if (plan_.run == 0 && !options_.start.empty()) mean = options_.start;
  for (std::size_t i = 0; i < boxes_.size(); ++i) mean[i] = boxes_[i].FromBox(mean[i]);
  cma_.emplace(mean, plan_.sigma, plan_.population,
               CmaEsOptions{options_.tolerances, options_.covariance, options_.adapt_rates});
  run_ = {plan_, 0, "", std::numeric_limits<double>::infinity()};
}

std::vector<double> Minimiser::mean() const {
  std::vector<double> mean(cma_->mean().begin(), cma_->mean().end());
  for (std::size_t i = 0; i < boxes_.size(); ++i) mean[i] = boxes_[i].ToBox(mean[i]);
  return mean;
}

std::span<const double> Minimiser::Ask() {
  if (asked_) return candidates_;
  candidates_.resize(static_cast<std::size_t>(dimension()) * population());
  cma_->Ask(DeriveKey(options_.seed, StreamPurpose::kSearchSampling,
                      {static_cast<std::uint32_t>(plan_.run),
                       static_cast<std::uint32_t>(cma_->generation())}),
            candidates_);
  for (std::size_t k = 0; k < boxes_.size() * population(); ++k) {
    candidates_[k] = boxes_[k % boxes_.size()].ToBox(candidates_[k]);
  }
  asked_ = true;
  return candidates_;
}

void Minimiser::Tell(std::span<const double> costs) {
  asked_ = false;
  if (CountCosts(costs)) {
    run_.stop = "target";
  } else {
    cma_->Tell(costs);
    ++generations_;
    scheduler_.Add(plan_, plan_.population);
    run_.stop = cma_->stop();
    if (run_.stop.empty() && scheduler_.IsExhausted(plan_, run_.evaluations)) {
      run_.stop = "SmallBudget";
    }
  }
  Advance();
}

bool Minimiser::CountCosts(std::span<const double> costs) {
  const auto n = static_cast<std::size_t>(dimension());
  for (std::size_t c = 0; c < costs.size(); ++c) {
    ++run_.evaluations;
    ++result_.evaluations;
    run_.best_cost = std::fmin(run_.best_cost, costs[c]);
    if (costs[c] < result_.best_cost || result_.best.empty()) {
      const auto first = candidates_.begin() + static_cast<std::ptrdiff_t>(c * n);
      result_.best.assign(first, first + static_cast<std::ptrdiff_t>(n));
      result_.best_cost = std::fmin(result_.best_cost, costs[c]);
    }
    if (costs[c] < options_.target) return true;
  }
  return false;
}

void Minimiser::Advance() {
  while (true) {
    if (run_.stop.empty() && result_.evaluations + plan_.population > options_.evaluations) {
      run_.stop = "budget";
    }
    if (run_.stop.empty()) return;
    result_.runs.push_back(run_);
    scheduler_.End(plan_);
    if (run_.stop == "target" || run_.stop == "budget" || !scheduler_.restarts()) {
      stop_ = run_.stop;
      return;
    }
    double draws[2];
    FillUniforms(RunKey(plan_.run + 1), 0, draws, 2);
    plan_ = scheduler_.Next(draws[0], draws[1]);
    StartRun();
  }
}

MinimiseResult Minimise(const MinimiseOptions& options, const PopulationObjective& objective) {
  Minimiser minimiser(options);
  std::vector<double> costs;
  while (minimiser.stop().empty()) {
    costs.resize(minimiser.population());
    objective(minimiser.Ask(), costs);
    minimiser.Tell(costs);
  }
  return minimiser.result();
}

}  // namespace downpour
