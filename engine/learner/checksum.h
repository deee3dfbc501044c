// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

namespace downpour {

// 64-bit FNV-1a of the bytes as 16 hexadecimal digits (http://www.isthe.com/chongo/tech/comp/fnv).
// It tells a file that changed by accident or by an edit, not one that was forged. Thread-safe.
std::string Checksum(std::string_view text);

}  // namespace downpour
