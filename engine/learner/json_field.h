// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace downpour {

// A JSON number, or "nan", "inf", "-inf" (JSON has none of these).
nlohmann::json JsonNumber(double value);
nlohmann::json JsonNumbers(const std::vector<double>& values);

// Parses a whole file. Throws InvalidInput that names `file` and the byte where it fails.
nlohmann::json ParseJson(std::string_view text, const std::string& file);

// A value in a JSON file that knows its place. Every reader throws InvalidInput "file: field: what
// was found: what it must be". The JSON value must outlive the field.
class JsonField {
 public:
  JsonField(const nlohmann::json& value, std::string file, std::string name = "")
      : value_(value), file_(std::move(file)), name_(std::move(name)) {}

  JsonField operator[](const char* key) const;  // member of an object
  std::vector<JsonField> Items() const;         // entries of an array

  const nlohmann::json& value() const { return value_; }
  bool Bool() const;
  std::int64_t Integer(std::int64_t low, std::int64_t high) const;  // low >= 0
  int Int(int low, int high) const { return static_cast<int>(Integer(low, high)); }
  double Number() const;  // also "nan", "inf", "-inf"
  std::string String() const;
  std::vector<double> Numbers() const;
  std::vector<std::string> Strings() const;

  [[noreturn]] void Fail(const std::string& allowed) const;

 private:
  const nlohmann::json& value_;
  std::string file_;
  std::string name_;
};

}  // namespace downpour
