// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <toml++/toml.h>

#include <string>
#include <vector>

#include "tools/downpour/config.h"

namespace downpour {

// Throws FileError if the file cannot be read, InvalidInput with file and line if it is no TOML.
toml::table ParseTomlFile(const std::string& path);

// A value of the file at `path`. A task's file is named from its folder.
Setting FileSetting(const std::string& path, const std::string& key, const toml::node& node);

// Appends all keys of a table of the file at `path`; a key of a table in a table is "outer.inner".
// Throws InvalidInput with file and line for a key or table that no field has.
void AppendSettings(const std::vector<Field>& fields, const std::string& path,
                    const toml::table& table, std::vector<Setting>* settings,
                    const std::string& prefix = "");

}  // namespace downpour
