// SPDX-License-Identifier: Apache-2.0
#include "tasks/model_digest.h"

#include <filesystem>
#include <set>
#include <vector>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/checksum.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

// Values of all attributes of that name in the text, in its order.
std::vector<std::string> Attributes(const std::string& text, const std::string& attribute) {
  constexpr const char* kSpace = " \t\r\n";
  std::vector<std::string> values;
  for (std::size_t at = text.find(attribute); at != std::string::npos;
       at = text.find(attribute, at)) {
    at = text.find_first_not_of(kSpace, at + attribute.size());
    if (at == std::string::npos || text[at] != '=') continue;
    at = text.find_first_not_of(kSpace, at + 1);
    if (at == std::string::npos || (text[at] != '"' && text[at] != '\'')) continue;
    const std::size_t end = text.find(text[at], at + 1);
    if (end == std::string::npos) break;
    values.push_back(text.substr(at + 1, end - at - 1));
    at = end;
  }
  return values;
}

// Appends the file and those it names; MuJoCo resolves all of them from the main file's folder.
void AppendFiles(const fs::path& file, const fs::path& folder, std::set<fs::path>* seen,
                 std::vector<fs::path>* files) {
  std::error_code error;
  if (!fs::is_regular_file(file, error) || !seen->insert(file).second) return;
  std::string text;
  try {
    text = ReadFile(file);
  } catch (const FileError&) {
    return;
  }
  files->push_back(file);
  std::vector<std::string> folders = {""};
  for (const char* attribute : {"meshdir", "texturedir"}) {
    for (const std::string& value : Attributes(text, attribute)) folders.push_back(value);
  }
  for (const std::string& name : Attributes(text, "file")) {
    for (const std::string& below : folders) {
      AppendFiles((folder / below / name).lexically_normal(), folder, seen, files);
    }
  }
}

}  // namespace

std::vector<fs::path> ModelFiles(const fs::path& mjcf_file) {
  std::set<fs::path> seen;
  std::vector<fs::path> files;
  AppendFiles(mjcf_file.lexically_normal(), mjcf_file.parent_path(), &seen, &files);
  return files;
}

std::string ModelDigest(const MujocoSystemSpec& spec) {
  if (spec.mjcf_file.empty()) return Checksum(spec.mjcf);
  std::string all;
  try {
    const std::vector<fs::path> files = ModelFiles(spec.mjcf_file);
    if (files.empty()) return "";
    for (const fs::path& file : files) all += ReadFile(file);
  } catch (const FileError&) {  // gone meanwhile
    return "";
  }
  return Checksum(all);
}

}  // namespace downpour
