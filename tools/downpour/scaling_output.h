// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tools/measure/expected_scaling.h"

namespace downpour {

// One search by some threads.
struct TimedSearch {
  bool weak = false;  // the search of one thread times their number
  int threads = 1, replicate = 0;
  double seconds = 0, rollout_seconds = 0;
  double lane_fill = 0, idle_share = 0;
  std::int64_t evaluations = 0;
};

// The searches on one task's model.
struct ScaledTask {
  std::string task;
  int points = 0;
  std::vector<std::string> plans;
  std::vector<TimedSearch> searches;
  std::vector<ExpectedSpeedUp> expected;
  double serial_share = 0;
};

struct ScalingReport {
  bool pinned = false;
  int replicates = 0;
  double load_average = 0;  // at the start
  std::vector<ScaledTask> tasks;
};

// Median and quartiles over the replicates, speed-up and efficiency of each against one thread.
struct ScalingRow {
  int threads = 1;
  double seconds[3] = {}, speed_up[3] = {}, efficiency[3] = {};  // quartile 1, median, quartile 3
  double lane_fill = 0, idle_share = 0;                          // medians
};
std::vector<ScalingRow> Summarise(const std::vector<TimedSearch>& searches, bool weak);

// For people, at most 80 columns wide.
void PrintScaling(const ScalingReport& report);

nlohmann::ordered_json ScalingJson(const ScalingReport& report);

// A row a search.
std::string ScalingCsv(const ScalingReport& report);

}  // namespace downpour
