// SPDX-License-Identifier: Apache-2.0
#include "engine/robot/split_words.h"

#include <string_view>

#include "engine/errors.h"

namespace downpour {
namespace {

// The position behind the quote that closes the one at `i`; what is in between goes to `word`.
std::size_t ReadQuoted(const std::string& command, std::size_t i, std::string* word) {
  const char quote = command[i++];
  for (; i < command.size(); ++i) {
    if (command[i] == quote) return i + 1;
    const bool escape = quote == '"' && command[i] == '\\' && i + 1 < command.size() &&
                        (command[i + 1] == '"' || command[i + 1] == '\\');
    if (escape) ++i;
    *word += command[i];
  }
  throw InvalidInput(std::string("a quote ") + quote + " is open: must be closed");
}

}  // namespace

std::vector<std::string> SplitWords(const std::string& command) {
  constexpr std::string_view kBlanks = " \t\r\n\v\f";
  if (command.find('\0') != std::string::npos) {
    throw InvalidInput("a zero byte: must not be in a command");
  }
  std::vector<std::string> words;
  bool in_word = false;
  for (std::size_t i = 0; i < command.size();) {
    const char c = command[i];
    if (kBlanks.find(c) != std::string_view::npos) {
      in_word = false;
      ++i;
      continue;
    }
    if (!in_word) words.emplace_back();  // also for '', an empty word
    in_word = true;
    if (c == '\'' || c == '"') {
      i = ReadQuoted(command, i, &words.back());
      continue;
    }
    if (c == '\\' && ++i == command.size()) {
      throw InvalidInput("a backslash at the end: must have a character behind it");
    }
    words.back() += command[i++];
  }
  if (words.empty() || words.front().empty()) {
    throw InvalidInput("no program: must be a program and its arguments");
  }
  return words;
}

}  // namespace downpour
