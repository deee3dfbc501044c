// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

namespace downpour {

// Value at `parameters` (P) and, written to `gradient` (P), its derivatives. Called from one thread
// at a time.
using ValueAndGradient =
    std::function<double(std::span<const double> parameters, std::span<double> gradient)>;

struct GradientSearchOptions {
  double bound = 5;       // parameters lie in +-bound; > 0
  int evaluations = 300;  // that a start may take (a line search under way is finished); >= 1
  int threads = 1;        // OpenMP threads that take the starts side by side; >= 1
};

struct GradientSearchProgress {
  std::int64_t evaluations = 0;  // all starts together
  std::int64_t budget = 0;
  int starts_done = 0;
  double best_value = 0;
};

// How the search from one start ended.
struct GradientSearchRun {
  std::vector<double> parameters;  // the best it met
  double value = 0;                // of these; -infinity: none was finite
  std::int64_t evaluations = 0;
  std::string stop;  // "converged", "budget" or "line search": no step along it was better
};

struct GradientSearchResult {
  int best = 0;  // index of the run with the highest value, the first of equals
  std::vector<GradientSearchRun> runs;  // one a start
};

// Maximises a function by L-BFGS (NLopt's; Nocedal 1980) from each of `starts` (P each), clipped to
// the bounds. A value that is not finite counts as minus infinity. `make_objective` is called once
// a start, by the thread that takes it. The result does not depend on the number of threads.
// `progress` (may be empty) is called after every evaluation, one call at a time; `stop` (may be
// null) is looked at before every evaluation and ends the search by throwing Interrupted. Rethrows
// what an objective throws. Throws InvalidInput for options out of range, no start, or starts of
// different sizes or without a finite value among them.
GradientSearchResult SearchByGradient(
    const GradientSearchOptions& options, const std::vector<std::vector<double>>& starts,
    const std::function<ValueAndGradient()>& make_objective,
    const std::function<void(const GradientSearchProgress&)>& progress,
    const std::atomic<bool>* stop);

}  // namespace downpour
