// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>

#include "tools/python/arguments.h"

namespace downpour::python {

// Throws TypeError that says how a call fails to be name(...) as `doc` has it, e.g. "predict(Xq,
// threads=2)": an argument is missing, unknown or there twice, or there are too many. Of a method,
// positional arguments begin with the object.
[[noreturn]] void RefuseCall(const std::string& doc, const std::string& name, bool is_method,
                             const py::args& positional, const py::kwargs& named);

// Functions of their own for calls that the function of that name, added before, does not take.
// pybind11's error would show all that was given, arrays and all.
template <typename Class>
void RefuseOtherCalls(py::class_<Class>* owner, const char* name, const char* doc) {
  const std::string full = py::str(owner->attr("__name__"));
  owner->def(name, [=](const py::args& positional, const py::kwargs& named) {
    RefuseCall(doc, full + "." + name, true, positional, named);
  });
}

template <typename Class>
void RefuseOtherConstruction(py::class_<Class>* owner, const char* doc) {
  const std::string full = py::str(owner->attr("__name__"));
  owner->def(
      py::init([=](const py::args& positional, const py::kwargs& named) -> std::unique_ptr<Class> {
        RefuseCall(doc, full, false, positional, named);
      }));
}

inline void RefuseOtherCalls(py::module_* module, const char* name, const char* doc) {
  module->def(name, [=](const py::args& positional, const py::kwargs& named) {
    RefuseCall(doc, name, false, positional, named);
  });
}

}  // namespace downpour::python
