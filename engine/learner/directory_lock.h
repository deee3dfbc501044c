// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

namespace downpour {

// The right to write into a directory, held by one object at a time on this machine: an flock on
// the directory itself, so that no file is left behind and the system takes it back however the
// process ends. File systems without such locks (some network ones) grant it to everybody.
class DirectoryLock {
 public:
  // Throws InvalidInput if another process, or another object of this one, holds it; FileError if
  // the directory cannot be opened.
  explicit DirectoryLock(const std::filesystem::path& directory);
  DirectoryLock(DirectoryLock&& other) noexcept;
  DirectoryLock& operator=(DirectoryLock&&) = delete;
  ~DirectoryLock();

 private:
  int fd_;
};

}  // namespace downpour
