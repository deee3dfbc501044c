// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <CLI/App.hpp>
#include <memory>
#include <string>
#include <vector>

#include "tools/downpour/config.h"

namespace downpour {

// `text` and the default of `field`, e.g. "Number of starts. (default 100)". Flags and empty
// strings have none to tell.
std::string WithDefault(const std::string& text, const Field& field);

// Adds `fields` as options of `command`; what is given goes into `settings`, for ApplySettings.
void AddFieldOptions(CLI::App* command, const std::vector<Field>& fields,
                     const std::shared_ptr<std::vector<Setting>>& settings);

// Refuses "".
CLI::Validator NotEmpty();

}  // namespace downpour
