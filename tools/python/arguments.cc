// SPDX-License-Identifier: Apache-2.0
#include "tools/python/arguments.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace downpour::python {
namespace {

std::string Shape(const py::array& array) { return py::str(array.attr("shape")); }

// "(n, D) with D = 6"
std::string Wanted(const std::vector<Extent>& shape) {
  std::string names, sizes;
  for (const Extent& extent : shape) {
    names += (names.empty() ? "" : ", ") + std::string(extent.name);
    if (extent.size < 0) continue;
    sizes += sizes.empty() ? " with " : ", ";
    sizes += std::string(extent.name) + " = " + std::to_string(extent.size);
  }
  return "(" + names + (shape.size() == 1 ? ",)" : ")") + sizes;
}

std::string Index(py::ssize_t flat, const Doubles& array) {
  std::string text;
  for (py::ssize_t d = array.ndim() - 1; d >= 0; --d) {
    text = std::to_string(flat % array.shape(d)) + (text.empty() ? "" : ", ") + text;
    flat /= array.shape(d);
  }
  return std::string("[").append(text).append("]");
}

[[noreturn]] void Refuse(const std::string& name, py::handle value, const std::string& allowed) {
  throw py::value_error(name + " = " + std::string(py::repr(value)) + ": must be " + allowed);
}

}  // namespace

Doubles ToArray(py::handle value, const std::string& name, const std::vector<Extent>& shape,
                bool finite) {
  const py::array array = py::array::ensure(value);
  if (!array) {
    throw py::type_error(name + ": " + std::string(py::str(py::type::of(value).attr("__name__"))) +
                         ", must be an array of numbers " + Wanted(shape));
  }
  // Never freed: Python may be gone before statics are.
  static const py::dtype& float64 = *new py::dtype(py::dtype::of<double>());
  if (!array.dtype().equal(float64)) {
    const py::object can_cast = py::module_::import("numpy").attr("can_cast");
    if (!can_cast(array.dtype(), float64, "safe").cast<bool>()) {
      throw py::type_error(name + ": dtype " + std::string(py::str(array.dtype())) +
                           ", must convert to float64 without loss");
    }
  }
  bool fits = array.ndim() == static_cast<py::ssize_t>(shape.size());
  for (std::size_t d = 0; fits && d < shape.size(); ++d) {
    fits = shape[d].size < 0 || array.shape(d) == shape[d].size;
  }
  if (!fits) throw py::value_error(name + ": shape " + Shape(array) + ", must be " + Wanted(shape));
  Doubles doubles = Doubles::ensure(array);
  if (!doubles) throw py::error_already_set();
  if (!finite) return doubles;
  const std::span<const double> values = Span(doubles);
  const auto bad =
      std::find_if(values.begin(), values.end(), [](double x) { return !std::isfinite(x); });
  if (bad != values.end()) {
    const std::string text = std::isnan(*bad) ? "nan" : *bad > 0 ? "inf" : "-inf";
    throw py::value_error(name + ": " + text + " at " + Index(bad - values.begin(), doubles) +
                          ", must be finite");
  }
  return doubles;
}

std::vector<double> ToVector(py::handle value, const std::string& name, Extent extent) {
  const Doubles array = ToArray(value, name, {extent});
  return {array.data(), array.data() + array.size()};
}

std::int64_t ToInteger(py::handle value, const std::string& name, std::int64_t low,
                       std::int64_t high) {
  const py::object index = py::reinterpret_steal<py::object>(PyNumber_Index(value.ptr()));
  if (!index) {
    PyErr_Clear();
    throw py::type_error(name + " = " + std::string(py::repr(value)) + ": must be an integer");
  }
  int overflow = 0;
  const std::int64_t number = PyLong_AsLongLongAndOverflow(index.ptr(), &overflow);
  if (overflow == 0 && number >= low && number <= high) return number;
  Refuse(name, value, "in [" + std::to_string(low) + ", " + std::to_string(high) + "]");
}

std::uint64_t ToSeed(py::handle value) {
  return static_cast<std::uint64_t>(
      ToInteger(value, "seed", 0, std::numeric_limits<std::int64_t>::max()));
}

double ToNumber(py::handle value, const std::string& name) {
  const double number = PyFloat_AsDouble(value.ptr());
  if (PyErr_Occurred() != nullptr) {
    PyErr_Clear();
    throw py::type_error(name + " = " + std::string(py::repr(value)) + ": must be a number");
  }
  if (!std::isfinite(number)) Refuse(name, value, "finite");
  return number;
}

int ToThreads(py::handle value) {
  const auto threads = static_cast<int>(ToInteger(value, "threads", 0, 4096));
  return threads == 0 ? omp_get_num_procs() : threads;
}

bool ToFlag(py::handle value, const std::string& name) {
  if (PyBool_Check(value.ptr()) != 0) return value.ptr() == Py_True;
  if (py::isinstance(value, py::module_::import("numpy").attr("bool_"))) {
    return value.attr("__bool__")().cast<bool>();
  }
  throw py::type_error(name + " = " + std::string(py::repr(value)) + ": must be True or False");
}

int ToChoice(py::handle value, const std::string& name, const std::vector<std::string>& choices) {
  std::string allowed;
  for (std::size_t i = 0; i < choices.size(); ++i) {
    if (py::isinstance<py::str>(value) && value.cast<std::string>() == choices[i]) {
      return static_cast<int>(i);
    }
    allowed += (i == 0 ? "one of '" : ", '") + choices[i] + "'";
  }
  Refuse(name, value, allowed);
}

py::array_t<double> FromVector(std::span<const double> values) {
  return py::array_t<double>(static_cast<py::ssize_t>(values.size()), values.data());
}

py::array_t<double> FromRows(std::span<const double> values, py::ssize_t columns) {
  const auto size = static_cast<py::ssize_t>(values.size());
  return py::array_t<double>({size / columns, columns}, values.data());
}

}  // namespace downpour::python
