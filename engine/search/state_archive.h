// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "engine/errors.h"

namespace downpour {

// The state of an object as a list of numbers: whole numbers below 2^53 and all doubles are exact.
// A class names its members once, in Visit(archive), for writing and for reading.
class StateWriter {
 public:
  template <typename T>
  requires std::is_arithmetic_v<T>
  void operator()(T& value) { numbers_.push_back(static_cast<double>(value)); }
  template <typename Derived>
  void operator()(Eigen::PlainObjectBase<Derived>& values) {
    numbers_.insert(numbers_.end(), values.data(), values.data() + values.size());
  }
  void operator()(std::vector<double>& values) {
    numbers_.push_back(static_cast<double>(values.size()));
    numbers_.insert(numbers_.end(), values.begin(), values.end());
  }

  std::vector<double> Take() { return std::move(numbers_); }

 private:
  std::vector<double> numbers_;
};

// Reads them back into an object of the same shape. Throws InvalidInput, naming `what`, if the
// list ends too early or holds a number that its place does not allow.
class StateReader {
 public:
  StateReader(std::span<const double> numbers, std::string what)
      : numbers_(numbers), what_(std::move(what)) {}

  template <typename T>
  requires std::is_arithmetic_v<T>
  void operator()(T& value) {
    const double number = Next(1)[0];
    if constexpr (std::is_integral_v<T>) {
      using Limits = std::numeric_limits<T>;
      if (!(std::abs(number) < 9007199254740992.0 && number == std::trunc(number) &&
            number >= static_cast<double>(Limits::min()) &&
            number <= static_cast<double>(Limits::max()))) {
        Refuse("holds a number where a whole one belongs");
      }
    }
    value = static_cast<T>(number);
  }
  template <typename Derived>
  void operator()(Eigen::PlainObjectBase<Derived>& values) {
    const auto numbers = Next(static_cast<std::size_t>(values.size()));
    std::copy(numbers.begin(), numbers.end(), values.data());
  }
  void operator()(std::vector<double>& values) {
    std::uint32_t size = 0;
    (*this)(size);
    const auto numbers = Next(size);
    values.assign(numbers.begin(), numbers.end());
  }

  // Throws unless everything has been read.
  void End() const {
    if (position_ != numbers_.size()) Refuse("is longer than that");
  }

 private:
  std::span<const double> Next(std::size_t n) {
    if (n > numbers_.size() - position_) Refuse("ends too early");
    position_ += n;
    return numbers_.subspan(position_ - n, n);
  }
  [[noreturn]] void Refuse(const std::string& why) const {
    throw InvalidInput(what_ + " of " + std::to_string(numbers_.size()) + " numbers " + why +
                       ": must be one that was saved");
  }

  std::span<const double> numbers_;
  std::string what_;
  std::size_t position_ = 0;
};

}  // namespace downpour
