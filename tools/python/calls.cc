// SPDX-License-Identifier: Apache-2.0
#include "tools/python/calls.h"

#include <algorithm>
#include <cctype>
#include <vector>

namespace downpour::python {
namespace {

struct Parameter {
  std::string name;
  bool required = false;
};

// Those of "name(a, b=(1, 2))" in the text.
std::vector<Parameter> ParametersOf(const std::string& doc, const std::string& name) {
  std::vector<Parameter> parameters;
  std::string text;
  int depth = 1;
  for (std::size_t i = doc.find(name + "(") + name.size() + 1; i < doc.size() && depth > 0; ++i) {
    const char c = doc[i];
    if (c == '(') ++depth;
    if (c == ')') --depth;
    const bool ends = depth == 0 || (depth == 1 && c == ',');
    if (!ends) {
      if (std::isspace(static_cast<unsigned char>(c)) == 0) text += c;
    } else if (!text.empty()) {
      parameters.push_back({text.substr(0, text.find('=')), text.find('=') == std::string::npos});
      text.clear();
    }
  }
  return parameters;
}

}  // namespace

void RefuseCall(const std::string& doc, const std::string& name, bool is_method,
                const py::args& positional, const py::kwargs& named) {
  const std::vector<Parameter> parameters = ParametersOf(doc, name.substr(name.rfind('.') + 1));
  std::string all;
  for (const Parameter& p : parameters) all += (all.empty() ? "" : ", ") + p.name;
  const std::string allowed = all.empty() ? "; there are none" : "; the arguments are " + all;
  const std::size_t n_given = positional.size() - (is_method && !positional.empty() ? 1 : 0);
  if (n_given > parameters.size()) {
    throw py::type_error(name + ": " + std::to_string(n_given) + " positional arguments" + allowed);
  }
  for (const auto& item : named) {
    const std::string key = py::str(item.first);
    const auto found = std::find_if(parameters.begin(), parameters.end(),
                                    [&](const Parameter& p) { return p.name == key; });
    if (found == parameters.end()) {
      throw py::type_error(name + ": unknown argument " + key + allowed);
    }
    if (static_cast<std::size_t>(found - parameters.begin()) < n_given) {
      throw py::type_error(name + ": argument " + key + " is given twice");
    }
  }
  for (std::size_t i = n_given; i < parameters.size(); ++i) {
    if (!parameters[i].required || named.contains(parameters[i].name)) continue;
    throw py::type_error(name + ": argument " + parameters[i].name + " is missing" + allowed);
  }
  throw py::type_error(name + ": must be called on an object of the class");
}

}  // namespace downpour::python
