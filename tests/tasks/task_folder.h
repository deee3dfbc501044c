// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <doctest/doctest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <sstream>
#include <string>

#include "tests/temporary_directory.h"

namespace downpour {

inline std::filesystem::path TasksFolder() {
  return std::filesystem::path(__FILE__).parent_path().parent_path().parent_path() / "tasks";
}

// A folder of a test's own with tasks/cartpole/cartpole.toml and its model, changed; removed at the
// end.
class TaskFolder {
 public:
  TaskFolder() { WriteModel("", ""); }

  const std::filesystem::path& path() const { return folder_.path(); }

  // Writes the task with the lines that begin with a key, behind spaces, replaced by the text
  // given; a list of several lines goes as a whole. Its path.
  std::string Cartpole(const std::map<std::string, std::string>& changes) const {
    std::istringstream lines(Read("cartpole.toml"));
    std::ofstream out(path() / "cartpole.toml");
    bool in_list = false;
    for (std::string line; std::getline(lines, line);) {
      if (in_list) {
        in_list = line != "]";
        continue;
      }
      const auto found = changes.find(line.substr(0, line.find(' ')));
      if (found == changes.end()) {
        out << line << "\n";
        continue;
      }
      in_list = line.ends_with("[");
      out << found->second << "\n";
    }
    return (path() / "cartpole.toml").string();
  }

  // Writes the model, `from` replaced by `to`.
  void WriteModel(const std::string& from, const std::string& to) const {
    std::string text = Read("cartpole.xml");
    if (!from.empty()) {
      REQUIRE(text.find(from) != std::string::npos);
      text.replace(text.find(from), from.size(), to);
    }
    std::ofstream(path() / "cartpole.xml") << text;
  }

 private:
  static std::string Read(const std::string& name) {
    std::ifstream file(TasksFolder() / "cartpole" / name);
    REQUIRE(file.is_open());
    return {std::istreambuf_iterator<char>(file), {}};
  }
  TemporaryDirectory folder_;
};

}  // namespace downpour
