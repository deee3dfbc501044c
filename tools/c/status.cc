// SPDX-License-Identifier: Apache-2.0
#include "tools/c/status.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace downpour::c {
namespace {

// Of fixed size, so that running out of memory can be told.
char* Message() {
  static thread_local char message[1024] = "";
  return message;
}

}  // namespace

int Fail(int status, const char* message) noexcept {
  std::snprintf(Message(), 1024, "%s", message);
  return status;
}

int FailWithException() noexcept {
  try {
    throw;
  } catch (const InvalidInput& e) {
    return Fail(DOWNPOUR_INVALID_INPUT, e.what());
  } catch (const FileError& e) {
    return Fail(DOWNPOUR_INVALID_INPUT, e.what());
  } catch (const CallbackFailed& e) {
    return Fail(DOWNPOUR_CALLBACK_FAILED, e.what());
  } catch (const std::bad_alloc&) {
    return Fail(DOWNPOUR_OUT_OF_MEMORY, "out of memory");
  } catch (const std::length_error&) {
    return Fail(DOWNPOUR_OUT_OF_MEMORY, "out of memory: a size beyond any");
  } catch (const std::exception& e) {
    return Fail(DOWNPOUR_INTERNAL_ERROR, e.what());
  } catch (...) {
    return Fail(DOWNPOUR_INTERNAL_ERROR, "unknown exception");
  }
}

void RequireSet(const void* pointer, const char* name) {
  if (pointer == nullptr) throw InvalidInput(std::string(name) + ": NULL, must be given");
}

void RequireRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return;
  char text[200];
  std::snprintf(text, sizeof text, "%s = %g: must be in [%g, %g]", name, value, low, high);
  throw InvalidInput(text);
}

std::span<const double> Numbers(const double* pointer, std::size_t size, const char* name) {
  if (size > 0) RequireSet(pointer, name);
  return {pointer, size};
}

std::span<double> Room(double* pointer, std::size_t size, const char* name) {
  if (size > 0) RequireSet(pointer, name);
  return {pointer, size};
}

void RequireFinite(std::span<const double> numbers, const char* name) {
  const auto bad =
      std::find_if(numbers.begin(), numbers.end(), [](double x) { return !std::isfinite(x); });
  if (bad == numbers.end()) return;
  throw InvalidInput(std::string(name) + "[" + std::to_string(bad - numbers.begin()) +
                     "] = " + std::to_string(*bad) + ": must be finite");
}

void Set(int value, int* to) {
  if (to != nullptr) *to = value;
}

int Threads(int threads) {
  RequireRange("threads", threads, 0, 4096);
  return threads == 0 ? omp_get_num_procs() : threads;
}

}  // namespace downpour::c

const char* downpour_last_error(void) { return downpour::c::Message(); }
