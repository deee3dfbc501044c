// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace downpour::python {

namespace py = pybind11;

// C-contiguous aligned doubles: what NumPy converts to without loss is converted, by a copy only
// where dtype or layout need one.
using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast |
                                        py::detail::npy_api::NPY_ARRAY_ALIGNED_>;

// One dimension of a shape: its name in messages, and its size, or -1 for any.
struct Extent {
  const char* name;
  py::ssize_t size = -1;
};

// `value` as doubles of the given shape. Throws TypeError or ValueError that names the argument and
// what was expected: for what is no array of numbers, another shape, or, if `finite`, NaN and
// infinity.
Doubles ToArray(py::handle value, const std::string& name, const std::vector<Extent>& shape,
                bool finite = true);

inline std::span<const double> Span(const Doubles& array) {
  return {array.data(), static_cast<std::size_t>(array.size())};
}
inline std::span<double> MutableSpan(py::array_t<double>* array) {
  return {array->mutable_data(), static_cast<std::size_t>(array->size())};
}
std::vector<double> ToVector(py::handle value, const std::string& name, Extent extent);

// Numbers. Throw TypeError or ValueError, as ToArray does.
std::int64_t ToInteger(py::handle value, const std::string& name, std::int64_t low,
                       std::int64_t high);
std::uint64_t ToSeed(py::handle value);
double ToNumber(py::handle value, const std::string& name);
int ToThreads(py::handle value);  // 0: all cores
bool ToFlag(py::handle value, const std::string& name);
// The index of `value` in `choices`.
int ToChoice(py::handle value, const std::string& name, const std::vector<std::string>& choices);

// A new array (values.size() or rows x columns) with these numbers.
py::array_t<double> FromVector(std::span<const double> values);
py::array_t<double> FromRows(std::span<const double> values, py::ssize_t columns);

}  // namespace downpour::python
