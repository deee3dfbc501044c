// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/pybind11.h>

#include <atomic>

#include "engine/errors.h"

namespace downpour::python {

// While one exists in the main thread, Ctrl-C (SIGINT) also sets a flag that the engine looks at;
// Python's own handler sees the signal as ever. Other threads are not interrupted, as in Python.
class InterruptScope {
 public:
  InterruptScope();
  ~InterruptScope();
  InterruptScope(const InterruptScope&) = delete;
  InterruptScope& operator=(const InterruptScope&) = delete;

  const std::atomic<bool>* flag() const;

 private:
  bool installed_ = false;
};

// Calls body(stop) without the GIL; on Ctrl-C the engine throws Interrupted, which becomes what
// Python's handler raises, KeyboardInterrupt by default.
template <typename Body>
void RunInterruptibly(const Body& body) {
  const InterruptScope scope;
  try {
    const pybind11::gil_scoped_release release;
    body(scope.flag());
  } catch (const Interrupted&) {
    if (PyErr_CheckSignals() == 0) PyErr_SetNone(PyExc_KeyboardInterrupt);
    throw pybind11::error_already_set();
  }
}

}  // namespace downpour::python
