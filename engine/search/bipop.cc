// SPDX-License-Identifier: Apache-2.0
#include "engine/search/bipop.h"

#include <algorithm>
#include <cmath>

#include "engine/search/state_archive.h"

namespace downpour {
namespace {

constexpr int kMaxDoublings = 9;

}  // namespace

RestartScheduler::RestartScheduler(RestartStrategy strategy, double default_population,
                                   int max_population, double sigma, double decades)
    : strategy_(strategy),
      default_population_(default_population),
      max_population_(std::max(static_cast<int>(default_population), max_population)),
      sigma_(sigma),
      decades_(decades) {}

int RestartScheduler::LargePopulation() const {
  const double population = std::ldexp(default_population_, doublings_);
  return static_cast<int>(std::min(population, static_cast<double>(max_population_)));
}

double RestartScheduler::DrawSmallSigma(double u) const {
  return sigma_ * std::pow(10.0, -decades_ * u);
}

RunPlan RestartScheduler::First(double sigma) {
  const int population = static_cast<int>(default_population_);
  small_.under_way += population;
  return {runs_started_++, Regime::kFirst, population, sigma};
}

RunPlan RestartScheduler::Next(double u_population, double u_sigma) {
  RunPlan run{runs_started_++, Regime::kSmall, static_cast<int>(default_population_), 0};
  if (strategy_ == RestartStrategy::kSmall) {
    run.sigma = DrawSmallSigma(u_sigma);
  } else if (strategy_ == RestartStrategy::kBipop &&
             small_.evaluations + small_.under_way < large_.evaluations + large_.under_way) {
    const double ratio = std::max(1.0, 0.5 * LargePopulation() / default_population_);
    run.population =
        static_cast<int>(default_population_ * std::pow(ratio, u_population * u_population));
    run.sigma = DrawSmallSigma(u_sigma);
  } else {
    if (doublings_ < kMaxDoublings || strategy_ == RestartStrategy::kIpop) ++doublings_;
    run = {run.run, Regime::kLarge, LargePopulation(), sigma_};
  }
  UsageOf(run).under_way += run.population;
  return run;
}

void RestartScheduler::Add(const RunPlan& run, std::int64_t evaluations) {
  UsageOf(run).evaluations += evaluations;
}

bool RestartScheduler::IsExhausted(const RunPlan& run, std::int64_t evaluations) const {
  return strategy_ == RestartStrategy::kBipop && run.regime == Regime::kSmall &&
         large_.under_way == 0 && 2 * evaluations > large_.evaluations;
}

void RestartScheduler::End(const RunPlan& run) { UsageOf(run).under_way -= run.population; }

template <typename Archive>
void RestartScheduler::Visit(Archive& archive) {
  archive(runs_started_);
  archive(doublings_);
  for (Usage* usage : {&large_, &small_}) {
    archive(usage->evaluations);
    archive(usage->under_way);
  }
}

std::vector<double> RestartScheduler::Save() const {
  StateWriter writer;
  RestartScheduler(*this).Visit(writer);
  return writer.Take();
}

void RestartScheduler::Restore(std::span<const double> state) {
  StateReader reader(state, "restarts: a state");
  RestartScheduler restored = *this;
  restored.Visit(reader);
  reader.End();
  *this = restored;
}

}  // namespace downpour
