// SPDX-License-Identifier: Apache-2.0
#include "engine/robot/split_words.h"

#include <doctest/doctest.h>

#include "engine/errors.h"

namespace downpour {
namespace {

using Words = std::vector<std::string>;

std::string SplitError(const std::string& command) {
  try {
    SplitWords(command);
  } catch (const InvalidInput& error) {
    return error.what();
  }
  return "";
}

TEST_CASE("split words: blanks separate, quotes and backslashes keep together") {
  CHECK(SplitWords("  my_robot\t--port  /dev/ttyUSB0\n") ==
        Words{"my_robot", "--port", "/dev/ttyUSB0"});
  CHECK(SplitWords("'my robot' \"a b\"'c d'e '' \"\"") == Words{"my robot", "a bc de", "", ""});
  CHECK(SplitWords(R"(a\ b \'c "d\"e\\f\n" '\"')") == Words{"a b", "'c", R"(d"e\f\n)", R"(\")"});
  CHECK(SplitWords("caf\xc3\xa9 \xff") == Words{"caf\xc3\xa9", "\xff"});
}

TEST_CASE("split words: what a shell would run or expand is nothing but text") {
  CHECK(SplitWords("a;b $(c) `d` $HOME * ~ | & > f && #x") ==
        Words{"a;b", "$(c)", "`d`", "$HOME", "*", "~", "|", "&", ">", "f", "&&", "#x"});
}

TEST_CASE("split words: what cannot be split is refused") {
  CHECK(SplitError("a 'b") == "a quote ' is open: must be closed");
  CHECK(SplitError("a \"b\\\"") == "a quote \" is open: must be closed");
  CHECK(SplitError("a b\\") == "a backslash at the end: must have a character behind it");
  CHECK(SplitError(" \t") == "no program: must be a program and its arguments");
  CHECK(SplitError("'' a") == "no program: must be a program and its arguments");
  CHECK(SplitError(std::string("a\0b", 3)) == "a zero byte: must not be in a command");
}

}  // namespace
}  // namespace downpour
