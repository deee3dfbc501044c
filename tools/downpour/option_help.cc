// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/option_help.h"

#include <fmt/format.h>

#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <variant>

namespace downpour {

std::string WithDefault(const std::string& text, const Field& field) {
  if (std::holds_alternative<bool*>(field.target)) return text;
  std::string value = ValueText(field);
  value.erase(
      std::remove_if(value.begin(), value.end(), [](char c) { return c == '"' || c == '\''; }),
      value.end());
  return value.empty() ? text : fmt::format("{} (default {})", text, value);
}

void AddFieldOptions(CLI::App* command, const std::vector<Field>& fields,
                     const std::shared_ptr<std::vector<Setting>>& settings) {
  for (const Field& field : fields) {
    const auto read = [settings, field](const std::string& text) {
      settings->push_back(ReadSetting(field.option, field, text));
    };
    command
        ->add_option_function<std::string>(field.option, read,
                                           WithDefault(field.description, field))
        ->type_name("N");
  }
}

Field EpisodeField(int* episode, const std::string& description) {
  return {.key = "episode",
          .option = "--episode",
          .target = episode,
          .min = 0,
          .max = 1000,
          .description = description};
}

CLI::Validator NotEmpty() {
  return CLI::Validator(
      [](std::string& text) { return std::string(text.empty() ? "must not be empty" : ""); }, "");
}

}  // namespace downpour
