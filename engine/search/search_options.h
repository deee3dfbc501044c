// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>

#include "engine/search/policy_search.h"

namespace downpour {

// Throws InvalidInput naming the field `search.<name>`, its value and the allowed range if an
// option is out of range, or if `start` is empty or has an entry that is not finite.
void CheckPolicySearchOptions(const PolicySearchOptions& options, std::span<const double> start);

// Throws InvalidInput if the budget has no room for the first generation of the search of `episode`
// and the final comparison; runs nothing. The options must have passed the check above.
void CheckSearchBudget(const PolicySearchOptions& options, std::span<const double> start,
                       std::uint64_t seed, std::uint32_t episode);

// What the learner changes for a search that has a last policy to start from, or none: without one
// no restart is local, with one exploration is not relaxed.
void AdaptToStart(bool has_last_policy, PolicySearchOptions* options);

}  // namespace downpour
