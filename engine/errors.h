// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <stdexcept>
#include <string>

namespace downpour {

// Input that a caller or user got wrong. what() is one line: what, where, what is allowed.
class InvalidInput : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// A file that cannot be read or written. what() names the file and the reason.
class FileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// A real system that could not go on: it did not answer, ended, answered nonsense or was stopped by
// its operator. what() is one line that says how.
class SystemFailure : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// A request to stop (Ctrl-C) was seen; nothing finished has been lost.
class Interrupted : public std::runtime_error {
 public:
  Interrupted() : std::runtime_error("interrupted") {}
};

}  // namespace downpour
