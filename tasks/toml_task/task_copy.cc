// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/task_copy.h"

#include <algorithm>
#include <iterator>

#include "engine/learner/atomic_file.h"
#include "tasks/model_digest.h"
#include "tasks/toml_task/toml_task.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

// The folder that both are below.
fs::path CommonFolder(const fs::path& a, const fs::path& b) {
  const auto [end, unused] = std::mismatch(a.begin(), a.end(), b.begin(), b.end());
  static_cast<void>(unused);
  fs::path folder;
  for (auto part = a.begin(); part != end; ++part) folder /= *part;
  return folder;
}

// The folder that `below` of it is the file.
fs::path FolderOf(const fs::path& file, const fs::path& below) {
  fs::path folder = file;
  for (auto part = below.begin(); part != below.end(); ++part) folder = folder.parent_path();
  return folder;
}

}  // namespace

std::vector<FileCopy> CopyTask(const std::string& file) {
  std::vector<fs::path> files = {fs::absolute(file).lexically_normal()};
  for (const fs::path& each : ModelFiles(fs::absolute(TaskModelFile(file)))) files.push_back(each);
  fs::path folder = files.front().parent_path();
  for (const fs::path& each : files) folder = CommonFolder(folder, each.parent_path());
  std::vector<FileCopy> copies;
  for (const fs::path& each : files) {
    copies.push_back({each.lexically_relative(folder), ReadFile(each)});
  }
  return copies;
}

std::string ChangedSince(const fs::path& copy, const fs::path& path, const fs::path& source) {
  const fs::path copies = FolderOf(copy, path), sources = FolderOf(source, path);
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(copies)) {
    const fs::path original = sources / entry.path().lexically_relative(copies);
    std::error_code error;
    if (!entry.is_regular_file() || !fs::is_regular_file(original, error)) continue;
    if (ReadFile(original) != ReadFile(entry.path())) return original.string();
  }
  return "";
}

}  // namespace downpour
