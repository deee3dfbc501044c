// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <exception>
#include <new>
#include <span>
#include <stdexcept>
#include <string>

#include "engine/errors.h"
#include "tools/c/downpour.h"

namespace downpour::c {

// A callback returned another number than 0.
class CallbackFailed : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// Keeps the message for downpour_last_error on this thread; returns the status. Does not throw.
int Fail(int status, const char* message) noexcept;

// The status of the exception that is being handled, with its message kept. Does not throw.
int FailWithException() noexcept;

// Calls body(), which returns nothing, and turns what it throws into a status.
template <typename Body>
int Guard(const Body& body) noexcept {
  try {
    body();
    return DOWNPOUR_OK;
  } catch (...) {
    return FailWithException();
  }
}

// Throws InvalidInput unless `pointer` is set.
void RequireSet(const void* pointer, const char* name);

// Throws InvalidInput unless low <= value <= high.
void RequireRange(const char* name, double value, double low, double high);

// The numbers at `pointer`, which must be set unless there are none.
std::span<const double> Numbers(const double* pointer, std::size_t size, const char* name);
std::span<double> Room(double* pointer, std::size_t size, const char* name);

// Throws InvalidInput, with the place, unless all are finite.
void RequireFinite(std::span<const double> numbers, const char* name);

// Threads of an argument: 0 is all cores. Throws InvalidInput if it is negative.
int Threads(int threads);

// Throws InvalidInput unless a structure of the caller has the size that this library knows.
template <typename T>
void RequireSize(const T* structure, const char* name) {
  RequireSet(structure, name);
  if (structure->size == sizeof(T)) return;
  throw InvalidInput(std::string(name) + ": size = " + std::to_string(structure->size) +
                     ": must be " + std::to_string(sizeof(T)) + ", sizeof of the structure");
}

// The caller's options, or if there are none the defaults that `init` sets.
template <typename T>
T OptionsOr(int (*init)(T*), const T* given) {
  if (given != nullptr) {
    RequireSize(given, "options");
    return *given;
  }
  T defaults = {};
  init(&defaults);
  return defaults;
}

// Calls set(options), which begin as zeros and their size: what *_options_init returns.
template <typename T, typename Body>
int InitOptions(T* options, const Body& set) noexcept {
  return Guard([&] {
    RequireSet(options, "options");
    *options = {};
    options->size = sizeof *options;
    set(*options);
  });
}

// Writes a number where the caller wants it.
void Set(int value, int* to);

}  // namespace downpour::c
