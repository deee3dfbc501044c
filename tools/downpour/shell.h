// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace downpour {

// `text` as one word of a POSIX shell's command line; in single quotes only where it must be.
std::string ShellWord(const std::string& text);

}  // namespace downpour
