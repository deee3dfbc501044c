// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/gradient_search.h"

#include <nlopt.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <memory>
#include <mutex>
#include <new>

#include "engine/errors.h"
#include "engine/parallel_for.h"

namespace downpour {
namespace {

// Change of the value below which a start has converged.
constexpr double kTolerance = 1e-6;

// What the starts report to, one at a time.
class Reporter {
 public:
  Reporter(std::int64_t budget, std::function<void(const GradientSearchProgress&)> call)
      : call_(std::move(call)) {
    progress_.budget = budget;
    progress_.best_value = -std::numeric_limits<double>::infinity();
  }

  void Evaluated(double best_value) {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++progress_.evaluations;
    progress_.best_value = std::max(progress_.best_value, best_value);
    if (call_) call_(progress_);
  }

  void Done() {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++progress_.starts_done;
  }

 private:
  std::mutex mutex_;
  std::function<void(const GradientSearchProgress&)> call_;
  GradientSearchProgress progress_;
};

// One start's search, as the callback of NLopt sees it.
struct StartSearch {
  ValueAndGradient objective;
  Reporter* reporter = nullptr;
  const std::atomic<bool>* stop = nullptr;
  nlopt_opt optimiser = nullptr;
  std::exception_ptr error;
  GradientSearchRun run;
};

// The next evaluation. Keeps the best point itself: NLopt loses it when it ends with a failure
// code.
double Evaluate(std::span<const double> x, std::span<double> gradient, StartSearch* search) {
  if (search->stop != nullptr && *search->stop) throw Interrupted();
  const double value = search->objective(x, gradient);
  ++search->run.evaluations;
  const bool finite =
      std::isfinite(value) &&
      std::all_of(gradient.begin(), gradient.end(), [](double g) { return std::isfinite(g); });
  if (finite && value > search->run.value) {
    search->run.value = value;
    search->run.parameters.assign(x.begin(), x.end());
  }
  search->reporter->Evaluated(search->run.value);
  return finite ? value : -std::numeric_limits<double>::infinity();
}

// Minus the value. Nothing may be thrown through NLopt.
double Objective(unsigned n, const double* x, double* gradient, void* data) {
  auto& search = *static_cast<StartSearch*>(data);
  const std::span<double> slopes(gradient, n);
  double value = -std::numeric_limits<double>::infinity();
  try {
    value = Evaluate({x, n}, slopes, &search);
  } catch (...) {
    search.error = std::current_exception();
    nlopt_force_stop(search.optimiser);
  }
  // Where there is no value the line search backs off.
  if (!std::isfinite(value)) {
    std::fill(slopes.begin(), slopes.end(), 0.0);
    return HUGE_VAL;
  }
  for (double& slope : slopes) slope = -slope;
  return -value;
}

std::string StopName(nlopt_result result) {
  if (result == NLOPT_MAXEVAL_REACHED) return "budget";
  return result > 0 ? "converged" : "line search";
}

GradientSearchRun Maximise(const GradientSearchOptions& options, std::vector<double> start,
                           ValueAndGradient objective, Reporter* reporter,
                           const std::atomic<bool>* stop) {
  for (double& x : start) x = std::clamp(x, -options.bound, options.bound);
  StartSearch search;
  search.objective = std::move(objective);
  search.reporter = reporter;
  search.stop = stop;
  search.run.parameters = start;
  search.run.value = -std::numeric_limits<double>::infinity();
  const std::unique_ptr<nlopt_opt_s, decltype(&nlopt_destroy)> optimiser(
      nlopt_create(NLOPT_LD_LBFGS, static_cast<unsigned>(start.size())), &nlopt_destroy);
  if (optimiser == nullptr) throw std::bad_alloc();
  search.optimiser = optimiser.get();
  nlopt_set_lower_bounds1(optimiser.get(), -options.bound);
  nlopt_set_upper_bounds1(optimiser.get(), options.bound);
  nlopt_set_maxeval(optimiser.get(), options.evaluations);
  nlopt_set_ftol_abs(optimiser.get(), kTolerance);
  nlopt_set_min_objective(optimiser.get(), Objective, &search);
  double minimum = 0;
  search.run.stop = StopName(nlopt_optimize(optimiser.get(), start.data(), &minimum));
  if (search.error) std::rethrow_exception(search.error);
  reporter->Done();
  return std::move(search.run);
}

void CheckArguments(const GradientSearchOptions& options,
                    const std::vector<std::vector<double>>& starts) {
  const auto refuse = [](const std::string& what) {
    throw InvalidInput("gradient search: " + what);
  };
  if (!(options.bound > 0 && std::isfinite(options.bound))) {
    refuse("bound is " + std::to_string(options.bound) + ", must be finite and > 0");
  }
  if (options.evaluations < 1) {
    refuse("evaluations is " + std::to_string(options.evaluations) + ", must be >= 1");
  }
  if (options.threads < 1) {
    refuse("threads is " + std::to_string(options.threads) + ", must be >= 1");
  }
  if (starts.empty() || starts.front().empty()) refuse("no start: must have one at least");
  for (const std::vector<double>& start : starts) {
    if (start.size() == starts.front().size() &&
        std::all_of(start.begin(), start.end(), [](double x) { return std::isfinite(x); })) {
      continue;
    }
    refuse("a start differs from the first in size or is not finite: must be " +
           std::to_string(starts.front().size()) + " finite numbers");
  }
}

}  // namespace

GradientSearchResult SearchByGradient(
    const GradientSearchOptions& options, const std::vector<std::vector<double>>& starts,
    const std::function<ValueAndGradient()>& make_objective,
    const std::function<void(const GradientSearchProgress&)>& progress,
    const std::atomic<bool>* stop) {
  CheckArguments(options, starts);
  const int n_starts = static_cast<int>(starts.size());
  Reporter reporter(static_cast<std::int64_t>(n_starts) * options.evaluations, progress);
  GradientSearchResult result;
  result.runs.resize(starts.size());
  ParallelFor(n_starts, std::min(options.threads, n_starts), [&](int i) {
    result.runs[i] = Maximise(options, starts[i], make_objective(), &reporter, stop);
  });
  for (int i = 1; i < n_starts; ++i) {
    if (result.runs[i].value > result.runs[result.best].value) result.best = i;
  }
  if (!std::isfinite(result.runs[result.best].value)) {
    throw InvalidInput("gradient search: the value is finite at no start: must be at one at least");
  }
  return result;
}

}  // namespace downpour
