// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/atomic_file.h"

#include <doctest/doctest.h>

#include "tests/learner/test_run.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

TEST_CASE("atomic file: what was written is read back, byte for byte, and replaces the old file") {
  const TemporaryDirectory directory;
  const fs::path file = directory.path() / "file";
  for (const std::size_t size : {0, 1, 65535, 65536, 65537, 1 << 20}) {
    std::string contents(size, '\0');
    for (std::size_t i = 0; i < size; ++i) contents[i] = static_cast<char>(i * 7 + size);
    WriteFileAtomically(file, contents);
    CHECK(ReadFile(file) == contents);
  }
  CHECK(std::distance(fs::directory_iterator(directory.path()), fs::directory_iterator()) == 1);
}

TEST_CASE("atomic file: a full disk leaves the old file and no temporary one") {
  const TemporaryDirectory directory;
  const fs::path file = directory.path() / "file";
  WriteFileAtomically(file, "old");
  // Every write to /dev/full fails with ENOSPC.
  fs::create_symlink("/dev/full", file.string() + ".tmp");
  const std::string error = ErrorOf<FileError>([&] { WriteFileAtomically(file, "new"); });
  CHECK(error == file.string() + ": cannot write: No space left on device");
  CHECK(ReadFile(file) == "old");
  CHECK_FALSE(fs::is_symlink(file.string() + ".tmp"));
  WriteFileAtomically(file, "new");
  CHECK(ReadFile(file) == "new");
}

TEST_CASE("atomic file: a target that cannot be replaced stays, and no temporary file") {
  const TemporaryDirectory directory;
  const fs::path target = directory.path() / "target";
  fs::create_directories(target / "inside");
  const std::string error = ErrorOf<FileError>([&] { WriteFileAtomically(target, "new"); });
  CHECK(error == target.string() + ": cannot write: Is a directory");
  CHECK(fs::exists(target / "inside"));
  CHECK_FALSE(fs::exists(target.string() + ".tmp"));
}

TEST_CASE("atomic file: errors name the file and the system's reason") {
  const TemporaryDirectory directory;
  const fs::path file = directory.path() / "file";
  WriteFileAtomically(file, "");
  CHECK(ErrorOf<FileError>([&] { WriteFileAtomically(file / "below", ""); }) ==
        (file / "below").string() + ": cannot write: Not a directory");
  CHECK(ErrorOf<FileError>([&] { WriteFileAtomically(directory.path() / "no" / "file", ""); }) ==
        (directory.path() / "no" / "file").string() + ": cannot write: No such file or directory");
  CHECK(ErrorOf<FileError>([&] { ReadFile(directory.path() / "no"); }) ==
        (directory.path() / "no").string() + ": cannot read: No such file or directory");
  CHECK(ErrorOf<FileError>([&] { ReadFile(directory.path()); }) ==
        directory.path().string() + ": cannot read: Is a directory");
}

}  // namespace
}  // namespace downpour
