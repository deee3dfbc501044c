// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "engine/search/policy_search.h"

namespace downpour {

// Throws InvalidInput naming the field `search.<name>`, its value and the allowed range if an
// option is out of range, or if `start` is empty or has an entry that is not finite.
void CheckPolicySearchOptions(const PolicySearchOptions& options, std::span<const double> start);

}  // namespace downpour
