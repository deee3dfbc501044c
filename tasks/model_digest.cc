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

// Values of all attributes `file` in the text, in its order.
std::vector<std::string> NamedFiles(const std::string& text) {
  constexpr const char* kSpace = " \t\r\n";
  std::vector<std::string> names;
  for (std::size_t at = text.find("file"); at != std::string::npos; at = text.find("file", at)) {
    at = text.find_first_not_of(kSpace, at + 4);
    if (at == std::string::npos || text[at] != '=') continue;
    at = text.find_first_not_of(kSpace, at + 1);
    if (at == std::string::npos || (text[at] != '"' && text[at] != '\'')) continue;
    const std::size_t end = text.find(text[at], at + 1);
    if (end == std::string::npos) break;
    names.push_back(text.substr(at + 1, end - at - 1));
    at = end;
  }
  return names;
}

// Appends the file and those it names; MuJoCo resolves all of them from the main file's folder.
void AppendFile(const fs::path& file, const fs::path& folder, std::set<fs::path>* seen,
                std::string* all) {
  std::error_code error;
  if (!fs::is_regular_file(file, error) || !seen->insert(file).second) return;
  const std::string text = ReadFile(file);
  *all += text;
  for (const std::string& name : NamedFiles(text)) AppendFile(folder / name, folder, seen, all);
}

}  // namespace

std::string ModelDigest(const MujocoSystemSpec& spec) {
  if (spec.mjcf_file.empty()) return Checksum(spec.mjcf);
  const fs::path file = spec.mjcf_file;
  std::set<fs::path> seen;
  std::string all;
  try {
    AppendFile(file, file.parent_path(), &seen, &all);
  } catch (const FileError&) {
    return "";
  }
  return seen.empty() ? "" : Checksum(all);
}

}  // namespace downpour
