// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/json_field.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "engine/errors.h"
#include "engine/learner/text_format.h"

namespace downpour {

nlohmann::json JsonNumber(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(FormatNumber(value));
}

nlohmann::json JsonNumbers(const std::vector<double>& values) {
  nlohmann::json array = nlohmann::json::array();
  for (const double value : values) array.push_back(JsonNumber(value));
  return array;
}

nlohmann::json ParseJson(std::string_view text, const std::string& file) {
  try {
    return nlohmann::json::parse(text.begin(), text.end());
  } catch (const nlohmann::json::parse_error& error) {
    const bool truncated = error.byte > text.size();
    throw InvalidInput(file + ": " + (truncated ? "truncated" : "corrupted") + " at byte " +
                       std::to_string(std::min(error.byte, text.size())) + " of " +
                       std::to_string(text.size()) + ": must be one whole JSON object");
  } catch (const nlohmann::json::out_of_range&) {
    throw InvalidInput(file + ": a number is beyond the range of a double: must be finite");
  }
}

JsonField JsonField::operator[](const char* key) const {
  const std::string name = name_.empty() ? key : name_ + "." + key;
  if (!value_.is_object()) Fail("an object");
  const auto member = value_.find(key);
  if (member == value_.end()) throw InvalidInput(file_ + ": " + name + " is missing");
  return JsonField(*member, file_, name);
}

std::vector<JsonField> JsonField::Items() const {
  if (!value_.is_array()) Fail("an array");
  std::vector<JsonField> items;
  items.reserve(value_.size());
  for (std::size_t i = 0; i < value_.size(); ++i) {
    items.emplace_back(value_[i], file_, name_ + "[" + std::to_string(i) + "]");
  }
  return items;
}

bool JsonField::Bool() const {
  if (!value_.is_boolean()) Fail("true or false");
  return value_.get<bool>();
}

std::int64_t JsonField::Integer(std::int64_t low, std::int64_t high) const {
  const std::string allowed =
      "an integer in [" + std::to_string(low) + ", " + std::to_string(high) + "]";
  if (!value_.is_number_integer()) Fail(allowed);
  // An unsigned number of 2^63 or more becomes negative, so below `low`.
  const std::int64_t number = value_.get<std::int64_t>();
  if (number < low || number > high) Fail(allowed);
  return number;
}

double JsonField::Number() const {
  if (value_.is_number()) return value_.get<double>();
  if (value_ == "nan") return std::numeric_limits<double>::quiet_NaN();
  if (value_ == "inf") return std::numeric_limits<double>::infinity();
  if (value_ == "-inf") return -std::numeric_limits<double>::infinity();
  Fail("a number");
}

std::string JsonField::String() const {
  if (!value_.is_string()) Fail("a string");
  return value_.get<std::string>();
}

std::vector<double> JsonField::Numbers() const {
  std::vector<double> numbers;
  for (const JsonField& item : Items()) numbers.push_back(item.Number());
  return numbers;
}

std::vector<std::string> JsonField::Strings() const {
  std::vector<std::string> strings;
  for (const JsonField& item : Items()) strings.push_back(item.String());
  return strings;
}

void JsonField::Fail(const std::string& allowed) const {
  std::string found = value_.dump(-1, ' ', true);
  if (found.size() > 60) found = found.substr(0, 57) + "...";
  throw InvalidInput(file_ + ": " + (name_.empty() ? "the file" : name_) + " = " + found +
                     ": must be " + allowed);
}

}  // namespace downpour
