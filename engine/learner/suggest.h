// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

namespace downpour {

// What to tell a user who wrote `name`: "did you mean X?" for the closest allowed name, else
// "allowed: " and all of them.
std::string Suggest(const std::string& name, const std::vector<std::string>& allowed);

// The allowed name that takes the fewest edits; `allowed` must not be empty.
std::string ClosestName(const std::string& name, const std::vector<std::string>& allowed);

// Whether `name` is `allowed` but for a typing slip.
bool IsSlip(const std::string& name, const std::string& allowed);

}  // namespace downpour
