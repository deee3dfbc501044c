// SPDX-License-Identifier: Apache-2.0
#include "engine/search/bipop.h"

#include <algorithm>
#include <cmath>

namespace downpour {
namespace {

constexpr int kMaxDoublings = 9;

}  // namespace

RestartScheduler::RestartScheduler(RestartStrategy strategy, int default_population,
                                   int max_population, double sigma, double decades)
    : strategy_(strategy),
      default_population_(default_population),
      max_population_(std::max(default_population, max_population)),
      sigma_(sigma),
      decades_(decades),
      large_population_(default_population) {}

double RestartScheduler::DrawSmallSigma(double u) const {
  return sigma_ * std::pow(10.0, -decades_ * u);
}

RunPlan RestartScheduler::First(double sigma) {
  return {runs_started_++, Regime::kFirst, default_population_, sigma};
}

RunPlan RestartScheduler::Next(double u_population, double u_sigma) {
  RunPlan run{runs_started_++, Regime::kSmall, default_population_, 0};
  if (strategy_ == RestartStrategy::kSmall) {
    run.sigma = DrawSmallSigma(u_sigma);
  } else if (small_.evaluations + small_.under_way < large_.evaluations + large_.under_way) {
    const double ratio = std::max(1.0, 0.5 * large_population_ / default_population_);
    run.population =
        static_cast<int>(default_population_ * std::pow(ratio, u_population * u_population));
    run.sigma = DrawSmallSigma(u_sigma);
  } else {
    doublings_ = std::min(doublings_ + 1, kMaxDoublings);
    const std::int64_t doubled = std::int64_t{default_population_} << doublings_;
    large_population_ = static_cast<int>(std::min<std::int64_t>(doubled, max_population_));
    run = {run.run, Regime::kLarge, large_population_, sigma_};
  }
  UsageOf(run).under_way += run.population;
  return run;
}

void RestartScheduler::Add(const RunPlan& run, std::int64_t evaluations) {
  if (run.regime != Regime::kFirst) UsageOf(run).evaluations += evaluations;
}

bool RestartScheduler::IsExhausted(const RunPlan& run, std::int64_t evaluations) const {
  return strategy_ == RestartStrategy::kBipop && run.regime == Regime::kSmall &&
         large_.under_way == 0 && 2 * evaluations > large_.evaluations;
}

void RestartScheduler::End(const RunPlan& run) {
  if (run.regime != Regime::kFirst) UsageOf(run).under_way -= run.population;
}

}  // namespace downpour
