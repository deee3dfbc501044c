// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "engine/rollout/reward.h"
#include "engine/rollout/task.h"
#include "tasks/toml_task/expression.h"
#include "tasks/toml_task/site_positions.h"

struct mjModel_;

namespace downpour {

// A formula of a task's numbers: its states, its features, for a reward its actions, and x, y and z
// of the model's sites, as "fingertip.x". Immutable: calls are thread-safe.
class TaskFormula {
 public:
  // Throws InvalidInput without the file's name; `state_of_joint` as SitePositions takes it.
  TaskFormula(const std::string& text, const Task& task, const mjModel_& model,
              const std::vector<int>& state_of_joint, bool with_actions);

  const std::string& text() const { return expression_->text(); }

  // result[lane], aligned, of a tile's states, features and actions (null: without). Does not
  // allocate.
  void Evaluate(const double* states, const double* features, const double* actions,
                double* result) const;

 private:
  // Most names and sites in one formula: what the stack of a thread holds with ease.
  static constexpr int kMaxNames = 64;
  static constexpr int kMaxSites = 8;
  enum class From { kState, kFeature, kAction, kSite };
  struct Row {
    From from;
    int row;
  };

  std::unique_ptr<const TileExpression> expression_;
  std::unique_ptr<const SitePositions> sites_;
  int n_sites_ = 0;
  std::vector<Row> rows_;  // of expression_->used()
};

// reward = the formula; `unit_interval`: clamped to [0, 1].
std::shared_ptr<const Reward> MakeFormulaReward(TaskFormula formula, bool unit_interval);

// exp(-d^power / (2 width^2)), d the distance (m) between sites 0 and 1 of `sites`, whose names are
// `from` and `to`; `power` is 1 or 2.
std::shared_ptr<const Reward> MakeSiteDistanceReward(SitePositions sites, const std::string& from,
                                                     const std::string& to, int power,
                                                     double width);

// Task::solved: true if the formula is neither 0 nor NaN at the beginning and the end of each of
// the last n_steps steps.
std::function<bool(std::span<const double>)> MakeSolvedTest(TaskFormula formula,
                                                            const std::vector<Feature>& features,
                                                            int n_states, int n_steps);

}  // namespace downpour
