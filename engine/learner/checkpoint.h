// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "engine/learner/learner.h"

namespace downpour {

// A checkpoint is one JSON object: "format", "version", "checksum" (64-bit FNV-1a of the compact
// text of "payload") and "payload": the settings that results depend on and the learner's state.
// The platform of each episode is part of the state and no setting: a run may go on on another
// machine, and PlatformDifference (platform.h) tells when its bits are then mixed.
// Finite numbers round-trip bit for bit; NaN and infinities are the strings "nan", "inf", "-inf".
inline constexpr int kCheckpointVersion = 10;

// The text of a checkpoint.
std::string FormatCheckpoint(const Task& task, const LearnerOptions& options,
                             const LearnerState& state);

// The state in the text of a checkpoint. `file` is the name that error messages give. Throws
// InvalidInput with one line that names the file, the field, what was found and what is allowed:
// text that is truncated or not JSON, a version this program does not read, a checksum that
// disagrees, fields that are missing or of the wrong type or size, and settings that differ from
// `task` and `options`. Not compared, so that a run may go on differently: episodes, until_solved
// and threads.
LearnerState ParseCheckpoint(const Task& task, const LearnerOptions& options, std::string_view text,
                             const std::string& file);

// The same from and to a file; they also throw FileError. Writing is atomic.
void WriteCheckpoint(const std::filesystem::path& path, const Task& task,
                     const LearnerOptions& options, const LearnerState& state);
LearnerState ReadCheckpoint(const std::filesystem::path& path, const Task& task,
                            const LearnerOptions& options);

}  // namespace downpour
