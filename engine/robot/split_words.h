// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

namespace downpour {

// The words of a command line, at least one, by the quoting rules of a shell and nothing else of
// it: blanks separate words; '...' is taken as it stands; in "..." a backslash takes a following "
// or \ as it stands; outside quotes it takes any character so. No variable, pattern, pipe or
// command is ever looked for. Throws InvalidInput, what() without the command's origin, if a quote
// or a last backslash is open, if there is no word, or if there is a zero byte. Thread-safe.
std::vector<std::string> SplitWords(const std::string& command);

}  // namespace downpour
