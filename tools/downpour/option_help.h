// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <CLI/App.hpp>
#include <memory>
#include <string>
#include <vector>

#include "tools/downpour/config.h"

namespace downpour {

// `text` and the default of `field`, e.g. "Number of starts. (default 100)". Flags and empty
// strings have none to tell.
std::string WithDefault(const std::string& text, const Field& field);

// Adds `fields` as options of `command`; what is given goes into `settings`, for ApplySettings.
void AddFieldOptions(CLI::App* command, const std::vector<Field>& fields,
                     const std::shared_ptr<std::vector<Setting>>& settings);

// Adds `fields(*arguments)` as options of `command`, which when it is called puts what was given
// into the arguments and calls run(*arguments).
template <typename Arguments, typename Run>
void RunWithFields(CLI::App* command, const std::shared_ptr<Arguments>& arguments,
                   std::vector<Field> (*fields)(Arguments&), const Run& run) {
  const auto settings = std::make_shared<std::vector<Setting>>();
  AddFieldOptions(command, fields(*arguments), settings);
  command->callback([=] {
    ApplySettings(fields(*arguments), *settings);
    run(*arguments);
  });
}

// --episode of commands that read a run.
Field EpisodeField(int* episode, const std::string& description);

// Refuses "".
CLI::Validator NotEmpty();

}  // namespace downpour
