// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/python_script.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "engine/errors.h"

namespace downpour {

void RunPythonScript(const std::string& script, std::vector<std::string> words) {
  constexpr const char* kPython = "/usr/bin/python3";
  words.insert(words.begin(), {kPython, "-P", "-c", script});
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  execv(kPython, argv.data());
  throw FileError(fmt::format("{}: {}: run tools/setup --pictures", kPython, std::strerror(errno)));
}

}  // namespace downpour
