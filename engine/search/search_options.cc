// SPDX-License-Identifier: Apache-2.0
#include "engine/search/search_options.h"

#include <cmath>
#include <cstddef>
#include <limits>
#include <sstream>
#include <string>

#include "engine/errors.h"

namespace downpour {
namespace {

template <typename T>
[[noreturn]] void Refuse(const std::string& name, T value, const std::string& wanted) {
  std::ostringstream message;
  message << "search." << name << " = " << value << ": must be " << wanted;
  throw InvalidInput(message.str());
}

template <typename T>
void CheckRange(const std::string& name, T value, T low, T high, const std::string& range) {
  // Written so that NaN is refused.
  if (!(value >= low && value <= high)) Refuse(name, value, "in " + range);
}

void CheckPositive(const std::string& name, double value) {
  if (!(value > 0 && value <= std::numeric_limits<double>::max())) {
    Refuse(name, value, "finite and > 0");
  }
}

}  // namespace

void CheckPolicySearchOptions(const PolicySearchOptions& options, std::span<const double> start) {
  CheckRange<std::int64_t>("evaluations", options.evaluations, 100, 1'000'000'000'000,
                           "[100, 1e12]");
  if (options.population != 0) {
    CheckRange("population", options.population, 2, 100000, "[2, 100000], or 0 (default)");
  }
  CheckRange("rollouts", options.rollouts, 1, 10000, "[1, 10000]");
  const bool adapts_rollouts = options.uncertainty == UncertaintyHandling::kRollouts;
  CheckRange("max_rollouts", options.max_rollouts, adapts_rollouts ? options.rollouts : 1, 10000,
             adapts_rollouts ? "[search.rollouts, 10000]" : "[1, 10000]");
  CheckRange("concurrent", options.concurrent, 1, 1024, "[1, 1024]");
  CheckRange("exploration", options.exploration, 0.1, 1.0, "[0.1, 1]");
  CheckRange("promotions", options.promotions, 1, 10, "[1, 10]");
  CheckRange("local_share", options.local_share, 0.0, 1.0, "[0, 1]");
  CheckRange("final_rollouts", options.final_rollouts, 1, 1'000'000, "[1, 1e6]");
  CheckRange("threads", options.threads, 1, 1 << 20, "[1, 1048576]");
  if (options.uncertainty == UncertaintyHandling::kLra &&
      ResolveForm(options.covariance, static_cast<int>(start.size())) ==
          CovarianceForm::kLimitedMemory) {
    Refuse("uncertainty", "lra",
           "off, sigma or rollouts where search.covariance is limited-memory");
  }
  if (options.stop_lost_causes && (options.uncertainty == UncertaintyHandling::kSigma ||
                                   options.uncertainty == UncertaintyHandling::kRollouts)) {
    Refuse("stop_lost_causes", "true",
           "false where search.uncertainty is sigma or rollouts, which rank all candidates");
  }
  CheckPositive("bound", options.bound);
  CheckPositive("first_sigma", options.first_sigma);
  CheckPositive("restart_sigma", options.restart_sigma);
  CheckRange("restart_decades", options.restart_decades, 0.0, 10.0, "[0, 10]");
  if (start.empty()) Refuse("start", "no parameters", "a vector of at least one");
  for (std::size_t i = 0; i < start.size(); ++i) {
    if (!std::isfinite(start[i])) {
      Refuse("start[" + std::to_string(i) + "]", start[i], "finite");
    }
  }
}

void AdaptToStart(bool has_last_policy, PolicySearchOptions* options) {
  if (has_last_policy) {
    options->relaxed_exploration = false;
  } else {
    options->local_share = 0;
  }
}

}  // namespace downpour
