// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "engine/learner/run_directory.h"
#include "tools/downpour/bytes.h"

namespace downpour {

// All files below a directory, if it is there, but temporary ones; a run's checkpoint first: what
// it holds, the others then hold too. Throws FileError.
std::vector<FileCopy> ReadTree(const std::filesystem::path& directory);

// Writes them there, each atomically, in reverse order. Throws FileError.
void WriteTree(const std::filesystem::path& directory, const std::vector<FileCopy>& files);

void PutFiles(const std::vector<FileCopy>& files, ByteWriter* message);
std::vector<FileCopy> GetFiles(ByteReader* message);

// A new directory for temporary files that goes with the object. Throws FileError.
class ScratchDirectory {
 public:
  ScratchDirectory();
  ~ScratchDirectory();
  ScratchDirectory(const ScratchDirectory&) = delete;
  ScratchDirectory& operator=(const ScratchDirectory&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace downpour
