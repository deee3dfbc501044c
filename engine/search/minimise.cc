// SPDX-License-Identifier: Apache-2.0
#include "engine/search/minimise.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <sstream>

#include "engine/errors.h"
#include "engine/search/bounds.h"

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
  Check(std::isfinite(o.sigma) && o.sigma > 0, "sigma", o.sigma, "finite and > 0");
  Check(o.population == 0 || o.population >= 2, "population", o.population, "0 or at least 2");
  Check(std::isfinite(o.restart_decades) && o.restart_decades >= 0, "restart_decades",
        o.restart_decades, "finite and >= 0");
  Check(o.evaluations >= 1, "evaluations", static_cast<double>(o.evaluations), "at least 1");
}

class Minimiser {
 public:
  Minimiser(const MinimiseOptions& options, const PopulationObjective& objective)
      : options_(options),
        objective_(objective),
        dimension_(options.lower.size()),
        scheduler_(options.restarts, Population(), kMaxPopulation, options.sigma,
                   options.restart_decades) {
    for (std::size_t i = 0; options.bounded && i < dimension_; ++i) {
      boxes_.emplace_back(options.lower[i], options.upper[i]);
    }
  }

  MinimiseResult Run() {
    RunPlan plan = scheduler_.First(options_.sigma);
    while (true) {
      RunOnce(plan);
      scheduler_.End(plan);
      const std::string& stop = result_.runs.back().stop;
      if (stop == "target" || stop == "budget" || !scheduler_.restarts()) return result_;
      double draws[2];
      FillUniforms(RunKey(plan.run + 1), 0, draws, 2);
      plan = scheduler_.Next(draws[0], draws[1]);
    }
  }

 private:
  static constexpr int kMaxPopulation = 1 << 20;

  double Population() const {
    return options_.population > 0 ? options_.population
                                   : CmaEs::DefaultPopulation(static_cast<int>(dimension_));
  }

  StreamKey RunKey(int run) const {
    return DeriveKey(options_.seed, StreamPurpose::kSearchRestart,
                     {static_cast<std::uint32_t>(run)});
  }

  CmaEs Start(const RunPlan& plan) const {
    std::vector<double> mean(dimension_);
    FillUniforms(RunKey(plan.run), 1, mean.data(), dimension_);
    for (std::size_t i = 0; i < dimension_; ++i) {
      mean[i] = options_.lower[i] + (options_.upper[i] - options_.lower[i]) * mean[i];
      if (options_.bounded) mean[i] = boxes_[i].FromBox(mean[i]);
    }
    return CmaEs(mean, plan.sigma, plan.population,
                 {options_.tolerances, options_.covariance, options_.adapt_rates});
  }

  void RunOnce(const RunPlan& plan) {
    CmaEs cma = Start(plan);
    const auto lambda = static_cast<std::size_t>(plan.population);
    candidates_.resize(dimension_ * lambda);
    costs_.resize(lambda);
    MinimiseRun run{plan, 0, "", std::numeric_limits<double>::infinity()};
    while (run.stop.empty()) {
      if (result_.evaluations + plan.population > options_.evaluations) {
        run.stop = "budget";
        break;
      }
      cma.Ask(DeriveKey(options_.seed, StreamPurpose::kSearchSampling,
                        {static_cast<std::uint32_t>(plan.run),
                         static_cast<std::uint32_t>(cma.generation())}),
              candidates_);
      for (std::size_t k = 0; k < boxes_.size() * lambda; ++k) {
        candidates_[k] = boxes_[k % dimension_].ToBox(candidates_[k]);
      }
      objective_(candidates_, costs_);
      if (CountCosts(&run)) {
        run.stop = "target";
        break;
      }
      cma.Tell(costs_);
      scheduler_.Add(plan, plan.population);
      run.stop = cma.stop();
      if (run.stop.empty() && scheduler_.IsExhausted(plan, run.evaluations)) {
        run.stop = "SmallBudget";
      }
    }
    result_.runs.push_back(std::move(run));
  }

  // Counts the population up to the first candidate that reaches the target; whether one does.
  bool CountCosts(MinimiseRun* run) {
    for (std::size_t c = 0; c < costs_.size(); ++c) {
      ++run->evaluations;
      ++result_.evaluations;
      run->best_cost = std::fmin(run->best_cost, costs_[c]);
      if (costs_[c] < result_.best_cost || result_.best.empty()) {
        const auto first = candidates_.begin() + static_cast<std::ptrdiff_t>(c * dimension_);
        result_.best.assign(first, first + static_cast<std::ptrdiff_t>(dimension_));
        result_.best_cost = std::fmin(result_.best_cost, costs_[c]);
      }
      if (costs_[c] < options_.target) return true;
    }
    return false;
  }

  const MinimiseOptions& options_;
  const PopulationObjective& objective_;
  std::size_t dimension_;
  RestartScheduler scheduler_;
  std::vector<BoxTransform> boxes_;  // (P), none if unbounded
  std::vector<double> candidates_, costs_;
  MinimiseResult result_;
};

}  // namespace

MinimiseResult Minimise(const MinimiseOptions& options, const PopulationObjective& objective) {
  CheckOptions(options);
  return Minimiser(options, objective).Run();
}

}  // namespace downpour
