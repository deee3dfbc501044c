// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <CLI/App.hpp>
#include <string>

#include "tools/downpour/config.h"

namespace downpour {

// `text` and the default of `field`, e.g. "Number of starts. (default 100)". Flags and empty
// strings have none to tell.
std::string WithDefault(const std::string& text, const Field& field);

// Refuses "".
CLI::Validator NotEmpty();

}  // namespace downpour
