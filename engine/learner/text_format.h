// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

#include "engine/rollout/task.h"

namespace downpour {

// The shortest text that reads back as the same double; "nan", "inf" or "-inf" otherwise.
std::string FormatNumber(double value);

// A field of a CSV file: NaN is empty; text is quoted where it must be.
std::string CsvField(double value);
std::string CsvField(std::string_view text);

// Name and unit of a column, e.g. "force [N]"; the name alone where there is no unit.
std::string ColumnName(std::string_view prefix, const Variable& variable);

}  // namespace downpour
