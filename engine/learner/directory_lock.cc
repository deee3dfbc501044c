// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/directory_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

#include "engine/errors.h"

namespace downpour {

DirectoryLock::DirectoryLock(const std::filesystem::path& directory)
    : fd_(::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {
  if (fd_ < 0) {
    throw FileError(directory.string() +
                    ": cannot open: " + std::generic_category().message(errno));
  }
  int failed;
  do {
    failed = ::flock(fd_, LOCK_EX | LOCK_NB);
  } while (failed != 0 && errno == EINTR);
  // Any other error: a file system without locks on directories.
  if (failed != 0 && errno == EWOULDBLOCK) {
    ::close(fd_);
    throw InvalidInput(directory.string() +
                       ": another process is writing this run: wait for its end, or stop it");
  }
}

DirectoryLock::DirectoryLock(DirectoryLock&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}

DirectoryLock::~DirectoryLock() {
  if (fd_ >= 0) ::close(fd_);
}

}  // namespace downpour
