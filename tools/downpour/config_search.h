// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "tools/downpour/config.h"

namespace downpour {

// The part of ConfigFields about how a policy is found.
std::vector<Field> SearchFields(PolicySearchOptions& search);
std::vector<Field> RolloutFields(EvaluatorOptions& rollout);
std::vector<Field> PilcoFields(PilcoOptions& pilco);

}  // namespace downpour
