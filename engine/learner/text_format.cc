// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/text_format.h"

#include <charconv>
#include <cmath>

namespace downpour {

std::string FormatNumber(double value) {
  if (std::isnan(value)) return "nan";
  char buffer[32];
  const std::to_chars_result result = std::to_chars(buffer, buffer + sizeof(buffer), value);
  return std::string(buffer, result.ptr);
}

std::string CsvField(double value) { return std::isnan(value) ? "" : FormatNumber(value); }

std::string CsvField(std::string_view text) {
  if (text.find_first_of(",\"\r\n") == std::string_view::npos) return std::string(text);
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
  return quoted + "\"";
}

std::string ColumnName(std::string_view prefix, const Variable& variable) {
  const std::string name = std::string(prefix) + variable.name;
  return variable.unit.empty() ? name : name + " [" + variable.unit + "]";
}

}  // namespace downpour
