// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/file_tree.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <system_error>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"

namespace downpour {

namespace fs = std::filesystem;

std::vector<FileCopy> ReadTree(const fs::path& directory) {
  constexpr const char* kFirst = "checkpoint.json";
  if (!fs::exists(directory)) return {};
  std::vector<fs::path> paths;
  std::error_code error;
  for (fs::recursive_directory_iterator entry(directory, error), end; !error && entry != end;
       entry.increment(error)) {
    const fs::path path = entry->path().lexically_relative(directory);
    // Those come and go while a run is under way.
    if (path.extension() != kTemporarySuffix && entry->is_regular_file()) paths.push_back(path);
  }
  if (error) throw FileError(directory.string() + ": cannot read: " + error.message());
  std::sort(paths.begin(), paths.end(), [&](const fs::path& a, const fs::path& b) {
    return std::pair(a != kFirst, a) < std::pair(b != kFirst, b);
  });
  std::vector<FileCopy> files;
  for (const fs::path& path : paths) files.push_back({path, ReadFile(directory / path)});
  return files;
}

void WriteTree(const fs::path& directory, const std::vector<FileCopy>& files) {
  for (auto file = files.rbegin(); file != files.rend(); ++file) {
    const fs::path path = directory / file->path;
    std::error_code error;
    fs::create_directories(path.parent_path(), error);
    if (error) {
      throw FileError(path.parent_path().string() + ": cannot create: " + error.message());
    }
    WriteFileAtomically(path, file->text);
  }
}

void PutFiles(const std::vector<FileCopy>& files, ByteWriter* message) {
  message->Put(files.size());
  for (const FileCopy& file : files) {
    message->PutAll(file.path.string());
    message->PutAll(file.text);
  }
}

std::vector<FileCopy> GetFiles(ByteReader* message) {
  std::vector<FileCopy> files;
  for (auto left = message->Get<std::size_t>(); left > 0; --left) {
    const std::string path = message->GetText();
    files.push_back({path, message->GetText()});
  }
  return files;
}

ScratchDirectory::ScratchDirectory() {
  std::string name = (fs::temp_directory_path() / "downpour-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) {
    throw FileError(name + ": cannot create: " + std::strerror(errno));
  }
  path_ = name;
}

ScratchDirectory::~ScratchDirectory() {
  std::error_code error;  // what cannot be removed stays
  fs::remove_all(path_, error);
}

}  // namespace downpour
