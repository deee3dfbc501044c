// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/python_script.h"

#include <fmt/format.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

#include "engine/errors.h"

namespace downpour {

extern const char* const k_pictures_py;  // pictures.py

namespace {

constexpr const char* kPython = "/usr/bin/python3";

// Makes `text` the standard input of this process.
void GiveStandardInput(std::string_view text) {
  const int file = memfd_create("input", 0);
  std::size_t done = 0;
  while (file >= 0 && done < text.size()) {
    const ssize_t n = write(file, text.data() + done, text.size() - done);
    if (n < 0) break;
    done += static_cast<std::size_t>(n);
  }
  if (file < 0 || done < text.size() || lseek(file, 0, SEEK_SET) != 0 ||
      dup2(file, STDIN_FILENO) < 0) {
    throw FileError(fmt::format("memfd: {}", std::strerror(errno)));
  }
}

}  // namespace

void RunPythonScript(const std::string& script, std::vector<std::string> words,
                     std::string_view input) {
  if (std::fflush(stdout) != 0) throw FileError("standard output: cannot write");
  GiveStandardInput(input);
  // With -P it imports nothing from the working directory.
  words.insert(words.begin(), {kPython, "-P", "-c", k_pictures_py + script});
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  execv(kPython, argv.data());
  throw FileError(fmt::format("{}: {}: run tools/setup --pictures", kPython, std::strerror(errno)));
}

void CheckPictureNames(const std::vector<std::string>& outputs) {
  for (const std::string& output : outputs) {
    if (output.ends_with(".png") || output.ends_with(".svg")) continue;
    throw InvalidInput(fmt::format("--output: {}: must end in .png or .svg", output));
  }
}

}  // namespace downpour
