// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/task_formula.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>
#include <utility>

#include "engine/errors.h"
#include "engine/rollout/one_lane.h"

namespace downpour {
namespace {

constexpr const char* kAxes[] = {".x", ".y", ".z"};

class FormulaReward final : public Reward {
 public:
  FormulaReward(TaskFormula formula, bool unit_interval)
      : formula_(std::move(formula)), unit_interval_(unit_interval) {}

  std::string Describe() const override {
    return formula_.text() + (unit_interval_ ? ", clamped to [0, 1]" : "");
  }
  bool InUnitInterval() const override { return unit_interval_; }
  void EvaluateTile(int, const double* states, const double* features, const double* actions,
                    double* rewards) const override {
    formula_.Evaluate(states, features, actions, rewards);
    if (!unit_interval_) return;
    for (int lane = 0; lane < kTileLanes; ++lane) {
      rewards[lane] = std::clamp(rewards[lane], 0.0, 1.0);  // NaN stays
    }
  }

 private:
  TaskFormula formula_;
  bool unit_interval_;
};

class SiteDistanceReward final : public Reward {
 public:
  SiteDistanceReward(SitePositions sites, const std::string& from, const std::string& to, int power,
                     double width)
      : sites_(std::move(sites)), power_(power), width_(width) {
    std::ostringstream text;
    text.precision(17);
    text << "exp(-d" << (power == 2 ? "^2" : "") << " / (2 x " << width
         << "^2)), d = distance in m of site " << from << " from site " << to;
    description_ = text.str();
  }

  std::string Describe() const override { return description_; }
  bool InUnitInterval() const override { return true; }
  void EvaluateTile(int, const double* states, const double*, const double*,
                    double* rewards) const override {
    alignas(kAlignment) double from[3 * kTileLanes], to[3 * kTileLanes];
    sites_.Evaluate(0, states, from);
    sites_.Evaluate(1, states, to);
    const double scale = -0.5 / (width_ * width_);
    for (int lane = 0; lane < kTileLanes; ++lane) {
      double squared = 0;
      for (int i = lane; i < 3 * kTileLanes; i += kTileLanes) {
        squared += (from[i] - to[i]) * (from[i] - to[i]);
      }
      rewards[lane] = std::exp(scale * (power_ == 2 ? squared : std::sqrt(squared)));
    }
  }

 private:
  SitePositions sites_;
  int power_;
  double width_;
  std::string description_;
};

}  // namespace

TaskFormula::TaskFormula(const std::string& text, const Task& task, const mjModel& model,
                         const std::vector<int>& state_of_joint, bool with_actions) {
  std::vector<std::string> names, site_names;
  std::vector<Row> rows;
  const auto add = [&](const std::string& name, From from, int row) {
    names.push_back(name);
    rows.push_back({from, row});
  };
  for (int i = 0; i < task.n_states(); ++i) add(task.states[i].name, From::kState, i);
  for (int i = 0; i < task.n_features(); ++i) {
    if (task.features[i].kind == FeatureKind::kIdentity) continue;  // has its state's name
    add(task.feature_names[i].name, From::kFeature, i);
  }
  for (int i = 0; with_actions && i < task.n_actions(); ++i) {
    add(task.actions[i].name, From::kAction, i);
  }
  for (int site = 0; site < model.nsite; ++site) {
    const char* const name = mj_id2name(&model, mjOBJ_SITE, site);
    site_names.push_back(name == nullptr ? "" : name);
    // A name that no formula can hold is none to offer.
    if (!IsFormulaName(site_names.back())) continue;
    for (int axis = 0; axis < 3; ++axis) {
      add(site_names.back() + kAxes[axis], From::kSite, 3 * site + axis);
    }
  }
  expression_ = std::make_unique<const TileExpression>(text, names);
  std::vector<std::string> sites;
  for (const std::string& name : expression_->used()) {
    Row row = rows[std::find(names.begin(), names.end(), name) - names.begin()];
    if (row.from == From::kSite) {
      const std::string& site = site_names[row.row / 3];
      const auto found = std::find(sites.begin(), sites.end(), site);
      row.row = static_cast<int>(found - sites.begin()) * 3 + row.row % 3;
      if (found == sites.end()) sites.push_back(site);
    }
    rows_.push_back(row);
  }
  n_sites_ = static_cast<int>(sites.size());
  if (rows_.size() > kMaxNames || n_sites_ > kMaxSites) {
    throw InvalidInput("has too many names: must be at most " + std::to_string(kMaxNames) +
                       " numbers and " + std::to_string(kMaxSites) + " sites");
  }
  sites_ = std::make_unique<const SitePositions>(model, state_of_joint, sites);
}

void TaskFormula::Evaluate(const double* states, const double* features, const double* actions,
                           double* result) const {
  alignas(kAlignment) double sites[kMaxSites][3 * kTileLanes];
  for (int site = 0; site < n_sites_; ++site) sites_->Evaluate(site, states, sites[site]);
  const std::array<const double*, 4> sources = {states, features, actions, sites[0]};
  std::array<const double*, kMaxNames> rows;
  for (std::size_t i = 0; i < rows_.size(); ++i) {
    rows[i] = sources[static_cast<std::size_t>(rows_[i].from)] + rows_[i].row * kTileLanes;
  }
  expression_->Evaluate(rows.data(), result);
}

std::shared_ptr<const Reward> MakeFormulaReward(TaskFormula formula, bool unit_interval) {
  return std::make_shared<FormulaReward>(std::move(formula), unit_interval);
}

std::shared_ptr<const Reward> MakeSiteDistanceReward(SitePositions sites, const std::string& from,
                                                     const std::string& to, int power,
                                                     double width) {
  return std::make_shared<SiteDistanceReward>(std::move(sites), from, to, power, width);
}

std::function<bool(std::span<const double>)> MakeSolvedTest(TaskFormula formula,
                                                            const std::vector<Feature>& features,
                                                            int n_states, int n_steps) {
  const auto shared = std::make_shared<const TaskFormula>(std::move(formula));
  return [=](std::span<const double> states) {
    const std::size_t width = static_cast<std::size_t>(n_states);
    const std::size_t n_rows = states.size() / width;
    const std::size_t n_last = static_cast<std::size_t>(n_steps) + 1;
    if (n_rows < n_last) return false;
    AlignedVector<double> tile(features.size() * kTileLanes), result(kTileLanes);
    for (std::size_t row = n_rows - n_last; row < n_rows; ++row) {
      const AlignedVector<double> state = ToOneLane(states.subspan(row * width, width));
      FeatureTile(features.data(), static_cast<int>(features.size()), state.data(), tile.data());
      shared->Evaluate(state.data(), tile.data(), nullptr, result.data());
      if (result[0] == 0 || std::isnan(result[0])) return false;
    }
    return true;
  };
}

}  // namespace downpour
