// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace downpour {

// Suffix of the temporary file that WriteFileAtomically makes beside its target.
inline constexpr std::string_view kTemporarySuffix = ".tmp";

// Replaces `path` by a file with these contents, or leaves it as it was: writes and syncs
// `path`.tmp, renames it, and syncs the directory. Throws FileError with the file and the system's
// reason (no space, read-only, ...); the temporary file is then gone. Only if the last step failed
// is the new file in place though this throws: whole, but a power cut may bring the old one back.
// One writer a path at a time.
void WriteFileAtomically(const std::filesystem::path& path, std::string_view contents);

// The whole file. Throws FileError with the file and the system's reason.
std::string ReadFile(const std::filesystem::path& path);

}  // namespace downpour
