// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "engine/learner/learner.h"
#include "engine/rollout/task.h"

namespace downpour {

// The real system, if it is no simulator.
struct SystemConfig {
  std::string program;  // "exec:PROGRAM ARGS"; empty: the task's simulator
  double timeout = 0;
  double setup_timeout = 60;
};

// A mean function of the dynamics from a simulator model, if there is one (docs/priors.md).
struct PriorConfig {
  std::string model;  // MJCF file; empty: none
  std::string free;   // list of its free parameters
};

// Everything that can be set for a run.
struct RunConfig {
  std::string task;         // a name, or the path of a TOML file
  std::string task_source;  // what that file is a copy of; empty: of none
  std::string preset;       // "": the task's own
  std::string mjcf;
  double observation_std = -1;  // negative: the task's own
  LearnerOptions learner;
  SystemConfig system;
  PriorConfig prior;
  std::string output_directory;
  bool quiet = false;
  bool json = false;
};

// One row of the table that TOML keys, command-line options, range checks, help texts and the saved
// config.toml all come from.
struct Field {
  std::string key;          // TOML key, e.g. "search.evaluations"
  std::string option = {};  // "--evaluations"; empty: only by --config and --set. A bool's option
                            // is a flag that turns the default round.
  std::variant<bool*, int*, std::int64_t*, std::uint64_t*, double*, std::string*, RestartStrategy*,
               UncertaintyHandling*, CovarianceForm*, CommonRandomNumbers*, QueryBackend*,
               PolicyKind*, Activation*, Algorithm*, std::vector<int>*>
      target;
  double min = 0;  // numbers and lists of numbers only
  double max = 0;
  bool above_min = false;                 // min itself is not allowed
  std::vector<std::string> choices = {};  // strings (empty: any) and enums (in their order)
  std::string ending = {};                // of strings that are allowed besides the choices
  std::string description;                // one sentence
  std::string option_help = {};           // of the option, where the description is not
  bool saved = true;                      // part of a run's config.toml
};

// Largest seed: TOML's largest integer.
inline constexpr double kMaxSeed = 9223372036854775807.0;

// The table, bound to the members of `config`.
std::vector<Field> ConfigFields(RunConfig& config);

// What `field` accepts, e.g. "an integer in [1, 1000]".
std::string Allowed(const Field& field);

// The value of `field` as TOML, with all digits.
std::string ValueText(const Field& field);

// A value somebody gave a field, and where: "run.toml:3", "--set", "--episodes". The text is the
// value as written; monostate is a TOML type that no field takes.
struct Setting {
  std::string origin;
  std::string key;
  std::variant<std::monostate, bool, std::int64_t, double, std::string, std::vector<std::int64_t>>
      value;
  std::string text;
};

// All keys of a TOML file; a task's file is named from its folder. Throws FileError if it cannot be
// read, InvalidInput with file and line for a syntax error or an unknown key or table.
std::vector<Setting> ReadConfigFile(const std::string& path);

// `text` for `field`, read as a TOML value where the field is no string.
Setting ReadSetting(const std::string& origin, const Field& field, const std::string& text);

// "a.b=c", as --set has it, with or without spaces round its parts. Throws InvalidInput.
Setting ParseAssignment(const std::string& origin, const std::string& text);

// Throws InvalidInput for what the command alone can do: output and real systems.
void RequireLibrarySetting(const Setting& setting);

// Writes the settings into the members of their fields, in order. Throws InvalidInput that names
// origin, key, value and what is allowed.
void ApplySettings(const std::vector<Field>& fields, const std::vector<Setting>& settings);

// The configuration that `settings` describe, later ones overriding earlier ones and all of them
// the task's own defaults, and its task. Throws InvalidInput, too if two settings name two tasks.
struct ResolvedRun {
  RunConfig config;
  Task task;
};
ResolvedRun ResolveConfig(const std::vector<Setting>& settings);

// TOML with every saved field, its description and what it accepts; numbers are exact.
std::string WriteConfig(const RunConfig& config);

}  // namespace downpour
