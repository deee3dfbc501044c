// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/algorithm.h"

#include <algorithm>

namespace downpour {

bool UsesSetting(Algorithm algorithm, std::string_view key) {
  if (algorithm != Algorithm::kPilco) return !key.starts_with("pilco.");
  if (key == "search.bound") return true;
  static constexpr std::array<std::string_view, 6> kOthers = {
      "search.", "rollout.", "prior.", "model.tolerance", "model.mean_tolerance", "model.backend"};
  return std::none_of(kOthers.begin(), kOthers.end(),
                      [&](std::string_view other) { return key.starts_with(other); });
}

}  // namespace downpour
