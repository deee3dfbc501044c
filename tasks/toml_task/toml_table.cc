// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/toml_table.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/suggest.h"
#include "engine/learner/text_format.h"

namespace downpour {
namespace {

// A value in a message; long ones are cut.
std::string ValueText(const toml::node& node) {
  std::ostringstream text;
  if (const auto* number = node.as_floating_point()) return FormatNumber(number->get());
  node.visit([&](const auto& value) { text << value; });
  constexpr std::size_t kMost = 60;
  const std::string all = text.str();
  return all.size() <= kMost ? all : all.substr(0, kMost) + "...";
}

std::string RangeText(const char* kind, const NumberRange& range) {
  const auto text = [](double x) {  // 1000000 rather than 1e+06
    return std::trunc(x) == x ? std::to_string(static_cast<long long>(x)) : FormatNumber(x);
  };
  return std::string(kind) + " in " + (range.above_min ? "(" : "[") + text(range.min) + ", " +
         text(range.max) + "]";
}

// The number in a node; NaN if it is none.
double NumberIn(const toml::node& node) {
  if (const auto* integer = node.as_integer()) return static_cast<double>(integer->get());
  if (const auto* number = node.as_floating_point()) return number->get();
  return std::numeric_limits<double>::quiet_NaN();
}

bool InRange(double x, const NumberRange& range) {  // false for NaN
  return (range.above_min ? x > range.min : x >= range.min) && x <= range.max;
}

}  // namespace

TomlTable::TomlTable(const toml::table& table, std::string file, std::string path)
    : table_(&table), file_(std::move(file)), path_(std::move(path)) {}

std::string TomlTable::Origin(const toml::node& node) const {
  return file_ + ":" + std::to_string(node.source().begin.line) + ": ";
}

void TomlTable::Fail(const std::string& key, const std::string& what) const {
  const toml::node* const node = table_->get(key);
  const std::string name = path_ + key;
  if (node == nullptr) throw InvalidInput(Origin(*table_) + name + ": missing; " + what);
  const bool brief = node->is_value();
  throw InvalidInput(Origin(*node) + name + (brief ? " = " + ValueText(*node) : "") + ": " + what);
}

void TomlTable::FailHere(const std::string& what) const {
  const std::string name = path_.substr(0, path_.empty() ? 0 : path_.size() - 1);
  throw InvalidInput(Origin(*table_) + name + (name.empty() ? "" : ": ") + what);
}

const toml::node* TomlTable::Find(const std::string& key) {
  asked_.push_back(key);
  return table_->get(key);
}

const toml::node& TomlTable::Require(const std::string& key, const std::string& allowed) {
  const toml::node* const node = Find(key);
  if (node == nullptr) Fail(key, "must be " + allowed);
  return *node;
}

std::string TomlTable::Text(const std::string& key) {
  const toml::node& node = Require(key, "a text that is not empty");
  const auto* const text = node.as_string();
  if (text == nullptr || text->get().empty()) Fail(key, "must be a text that is not empty");
  return text->get();
}

double TomlTable::Number(const std::string& key, NumberRange range) {
  const std::string allowed = RangeText("a number", range);
  const double number = NumberIn(Require(key, allowed));
  if (!InRange(number, range)) Fail(key, "must be " + allowed);
  return number;
}

double TomlTable::Number(const std::string& key, NumberRange range, double missing) {
  if (Has(key)) return Number(key, range);
  asked_.push_back(key);
  return missing;
}

int TomlTable::Integer(const std::string& key, NumberRange range) {
  const std::string allowed = RangeText("an integer", range);
  const double number = NumberIn(Require(key, allowed));
  if (!InRange(number, range) || std::trunc(number) != number) Fail(key, "must be " + allowed);
  return static_cast<int>(number);
}

int TomlTable::Integer(const std::string& key, NumberRange range, int missing) {
  if (Has(key)) return Integer(key, range);
  asked_.push_back(key);
  return missing;
}

bool TomlTable::Flag(const std::string& key, bool missing) {
  const toml::node* const node = Find(key);
  if (node == nullptr) return missing;
  const auto* const flag = node->as_boolean();
  if (flag == nullptr) Fail(key, "must be true or false");
  return flag->get();
}

std::vector<std::string> TomlTable::Texts(const std::string& key, std::size_t count) {
  const std::string allowed = "an array of " + std::to_string(count) + " texts";
  const auto* const array = Require(key, allowed).as_array();
  if (array == nullptr || array->size() != count) Fail(key, "must be " + allowed);
  std::vector<std::string> texts;
  for (const toml::node& node : *array) {
    const auto* const text = node.as_string();
    if (text == nullptr) Fail(key, "must be " + allowed);
    texts.push_back(text->get());
  }
  return texts;
}

std::optional<TomlTable> TomlTable::Table(const std::string& key) {
  const toml::node* const node = Find(key);
  if (node == nullptr) return std::nullopt;
  const auto* const table = node->as_table();
  if (table == nullptr) Fail(key, "must be a table");
  return TomlTable(*table, file_, path_ + key + ".");
}

std::vector<TomlTable> TomlTable::Tables(const std::string& key) {
  const std::string allowed = "an array of tables, at least one";
  const auto* const array = Require(key, allowed).as_array();
  if (array == nullptr || array->empty()) Fail(key, "must be " + allowed);
  std::vector<TomlTable> tables;
  for (const toml::node& node : *array) {
    const auto* const table = node.as_table();
    if (table == nullptr) Fail(key, "must be " + allowed);
    tables.emplace_back(*table, file_, path_ + key + "[" + std::to_string(tables.size()) + "].");
  }
  return tables;
}

std::vector<double> TomlTable::NumbersOf(const std::vector<std::string>& names) {
  std::vector<double> numbers;
  for (const std::string& name : names) numbers.push_back(Number(name, {-1e6, 1e6}, 0));
  return numbers;
}

void TomlTable::CheckNoOthers() const {
  for (const auto& [key, node] : *table_) {
    const std::string name(key.str());
    if (std::find(asked_.begin(), asked_.end(), name) != asked_.end()) continue;
    const std::string line = std::to_string(key.source().begin.line);
    throw InvalidInput(file_ + ":" + line + ": unknown key " + path_ + name + "; " +
                       Suggest(name, asked_));
  }
}

}  // namespace downpour
