// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "engine/learner/run_directory.h"

namespace downpour {

// The texts of a task's file, which comes first, of its model and of all that the model names
// (ModelFiles), with paths from the folder that all of them lie below: in one folder together, they
// are the same task. Throws FileError or, if the TOML is wrong, InvalidInput.
std::vector<FileCopy> CopyTask(const std::string& file);

// The first of the files that a copy was made from that has another text now; "" if none has, or
// those that differ are gone. `copy` is the copied task's file, at `path` below its folder;
// `source` the file that it was copied from. Throws FileError.
std::string ChangedSince(const std::filesystem::path& copy, const std::filesystem::path& path,
                         const std::filesystem::path& source);

}  // namespace downpour
