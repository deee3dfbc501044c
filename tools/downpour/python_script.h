// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace downpour {

// Replaces this process by Python running pictures.py and `script`, as one, with `words` as its
// arguments and `input` as its standard input: the script's exit status is the command's. Standard
// output is flushed before. Throws FileError if that fails.
[[noreturn]] void RunPythonScript(const std::string& script, std::vector<std::string> words,
                                  std::string_view input = {});

// Throws InvalidInput unless every one of `--output`'s pictures ends in .png or .svg.
void CheckPictureNames(const std::vector<std::string>& outputs);

}  // namespace downpour
