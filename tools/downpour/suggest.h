// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

namespace downpour {

// What to tell a user who wrote `name`: "did you mean X?" for the closest allowed name, else
// "allowed: " and all of them.
std::string Suggest(const std::string& name, const std::vector<std::string>& allowed);

}  // namespace downpour
