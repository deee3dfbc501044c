// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <toml++/toml.h>

#include <optional>
#include <string>
#include <vector>

namespace downpour {

// Numbers that a key takes.
struct NumberRange {
  double min, max;
  bool above_min = false;  // min itself is not allowed
};

// One table of a TOML file as its reader wants it: typed, every key at most once asked for and
// none left over. Every error is an InvalidInput "FILE:LINE: KEY = VALUE: must be ..."; an index in
// a key counts from 0, as in "states[2].unit".
class TomlTable {
 public:
  // `path`: of the table in the file, with a dot at its end; "" for the file itself. The table must
  // outlive the reader.
  TomlTable(const toml::table& table, std::string file, std::string path);

  bool Has(const std::string& key) const { return table_->contains(key); }

  // Of a key that must be there, or may be missing where there is a default.
  std::string Text(const std::string& key);
  double Number(const std::string& key, NumberRange range);
  double Number(const std::string& key, NumberRange range, double missing);
  int Integer(const std::string& key, NumberRange range);
  int Integer(const std::string& key, NumberRange range, int missing);
  bool Flag(const std::string& key, bool missing);
  // A pair of texts; the table of a key, nothing if it is missing; an array of tables, at least
  // one.
  std::vector<std::string> Texts(const std::string& key, std::size_t count);
  std::optional<TomlTable> Table(const std::string& key);
  std::vector<TomlTable> Tables(const std::string& key);
  // Numbers by name; the names that are allowed are asked for by it.
  std::vector<double> NumbersOf(const std::vector<std::string>& names);

  // Throws unless every key was asked for.
  void CheckNoOthers() const;

  // "FILE:LINE: KEY = VALUE: " and `what`, of a key that is there or not.
  [[noreturn]] void Fail(const std::string& key, const std::string& what) const;
  // "FILE:LINE: TABLE" and `what`.
  [[noreturn]] void FailHere(const std::string& what) const;

 private:
  const toml::node* Find(const std::string& key);
  const toml::node& Require(const std::string& key, const std::string& allowed);
  std::string Origin(const toml::node& node) const;

  const toml::table* table_;
  std::string file_, path_;
  std::vector<std::string> asked_;
};

}  // namespace downpour
