// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

namespace downpour {

// Runs the text of a script with these arguments. It takes the process over: its exit status is the
// command's. It imports nothing from the working directory. Throws FileError if there is no Python.
[[noreturn]] void RunPythonScript(const std::string& script, std::vector<std::string> words);

}  // namespace downpour
