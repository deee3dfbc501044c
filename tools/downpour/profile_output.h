// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "tools/measure/rollout_profile.h"

namespace downpour {

// The profile of one model.
struct ProfiledModel {
  int episode = 0;  // of a saved run; 0: synthetic
  int points = 0, n_inputs = 0, n_outputs = 0;
  std::vector<std::string> plans;
  RolloutProfile profile;
};

// All that `downpour profile` finds out.
struct ProfileReport {
  std::string subject;  // "runs/cartpole-seed0", "synthetic, D = 6, E = 4"
  Ceilings ceilings;
  std::vector<ProfiledModel> models;
};

// Of one model: all GP costs together.
struct QueryCosts {
  double ns = 0;
  Work work;
};
QueryCosts SumOfQueryCosts(const RolloutProfile& profile);

// Where a model's factors lie.
MemoryLevel LevelOf(const ProfiledModel& model);

// For people, at most 80 columns wide.
void PrintProfile(const ProfileReport& report);

nlohmann::ordered_json ProfileJson(const ProfileReport& report);

}  // namespace downpour
