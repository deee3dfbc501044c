// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "tools/downpour/config.h"

namespace downpour {

// One variant on one task of a study.
struct StudyVariant {
  std::string task;  // its name
  std::string name;
  std::string origin;             // where the file names it
  int replicates = 0;             // seeds first_seed, first_seed + 1, ...
  std::vector<Setting> settings;  // as `downpour learn` is to be given them, the task's file first
  RunConfig config;               // what they give
  double control_period = 0;      // s
  int horizon = 0;
};

// A study: every variant on every task, each with so many seeds.
struct Study {
  int jobs = 0;     // runs side by side; 0: one a core
  int threads = 0;  // of a run; 0: the cores shared out among the jobs
  std::uint64_t first_seed = 1;
  std::vector<StudyVariant> variants;  // task by task
};

// What may also be said on the command line.
std::vector<Field> JobFields(Study* study);

// All settings are checked as `downpour learn` does. Throws FileError, InvalidInput with file and
// line.
Study ReadStudyFile(const std::string& path);

// The settings that a run's results depend on, as TOML by key: without the seed, and without the
// number of episodes, as more of them change none of the first.
std::map<std::string, std::string> ResultSettings(const RunConfig& config);

// KEY=VALUE for --set.
std::string Assignment(const Setting& setting);

}  // namespace downpour
