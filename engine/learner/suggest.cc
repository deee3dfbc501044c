// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/suggest.h"

#include <algorithm>
#include <cstddef>
#include <numeric>

namespace downpour {
namespace {

// Levenshtein distance.
std::size_t EditDistance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 0; i < a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i + 1;
    for (std::size_t j = 0; j < b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i] == b[j] ? 0 : 1);
      diagonal = row[j + 1];
      row[j + 1] = std::min({replaced, row[j] + 1, row[j + 1] + 1});
    }
  }
  return row.back();
}

}  // namespace

std::string ClosestName(const std::string& name, const std::vector<std::string>& allowed) {
  return *std::min_element(allowed.begin(), allowed.end(),
                           [&](const std::string& a, const std::string& b) {
                             return EditDistance(name, a) < EditDistance(name, b);
                           });
}

bool IsSlip(const std::string& name, const std::string& allowed) {
  // More than a third of the letters wrong is no typing slip.
  return 3 * EditDistance(name, allowed) <= name.size();
}

std::string Suggest(const std::string& name, const std::vector<std::string>& allowed) {
  const std::string closest = ClosestName(name, allowed);
  if (!name.empty() && IsSlip(name, closest)) return "did you mean " + closest + "?";
  std::string list;
  for (const std::string& each : allowed) list += (list.empty() ? "allowed: " : ", ") + each;
  return list;
}

}  // namespace downpour
