// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/reward.h"

#include <charconv>
#include <cmath>
#include <utility>

#include "engine/errors.h"
#include "engine/rollout/one_lane.h"
#include "kernels/features/features.h"
#include "kernels/reward/reward.h"

namespace downpour {
namespace {

// The shortest text that reads back as the same double.
std::string Shortest(double value) {
  char buffer[32];
  return std::string(buffer, std::to_chars(buffer, buffer + sizeof(buffer), value).ptr);
}

void CheckEach(const std::string& name, const std::vector<double>& values, std::size_t wanted) {
  if (values.size() != wanted) {
    throw InvalidInput("reward: " + name + " has " + std::to_string(values.size()) +
                       " entries: must be " + std::to_string(wanted));
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (std::isfinite(values[i])) continue;
    throw InvalidInput("reward: " + name + "[" + std::to_string(i) + "] = " + Shortest(values[i]) +
                       ": must be finite");
  }
}

// Appends a term of a sum; `name` may be empty.
void AppendTerm(double factor, const std::string& name, std::string* sum) {
  if (factor == 0) return;
  const bool first = sum->empty();
  *sum += factor < 0 ? (first ? "-" : " - ") : (first ? "" : " + ");
  const std::string size = Shortest(std::abs(factor));
  *sum += name.empty() ? size : size == "1" ? name : size + " " + name;
}

class SaturatingReward final : public Reward {
 public:
  SaturatingReward(std::span<const Variable> feature_names, SaturatingParameters parameters)
      : n_features_(static_cast<int>(feature_names.size())), parameters_(std::move(parameters)) {
    const auto& [a, b, width] = parameters_;
    CheckEach("b", b, b.size());
    CheckEach("a", a, b.size() * feature_names.size());
    if (!(std::isfinite(width) && width > 0)) {
      throw InvalidInput("reward: width = " + Shortest(width) + ": must be finite and > 0");
    }
    description_ = "exp(-d^2 / (2 x " + Shortest(width) + "^2)), d^2 = ";
    for (std::size_t row = 0; row < b.size(); ++row) {
      std::string residual;
      for (std::size_t f = 0; f < feature_names.size(); ++f) {
        AppendTerm(a[row * feature_names.size() + f], feature_names[f].name, &residual);
      }
      AppendTerm(-b[row], "", &residual);
      description_ += (row > 0 ? " + (" : "(") + residual + ")^2";
    }
  }

  std::string Describe() const override { return description_; }
  bool InUnitInterval() const override { return true; }
  const SaturatingParameters* saturating() const override { return &parameters_; }

  void EvaluateTile(int, const double*, const double* features, const double*,
                    double* rewards) const override {
    SaturatingRewardTile(static_cast<int>(parameters_.b.size()), n_features_, parameters_.a.data(),
                         parameters_.b.data(), parameters_.width, features, rewards);
  }

 private:
  int n_features_;
  SaturatingParameters parameters_;
  std::string description_;
};

}  // namespace

std::shared_ptr<const Reward> MakeSaturatingReward(std::span<const Variable> feature_names,
                                                   std::vector<double> a, std::vector<double> b,
                                                   double width) {
  return std::make_shared<SaturatingReward>(
      feature_names, SaturatingParameters{std::move(a), std::move(b), width});
}

double ComputeReward(const Task& task, int step, std::span<const double> state,
                     std::span<const double> action) {
  const AlignedVector<double> states = ToOneLane(state), actions = ToOneLane(action);
  AlignedVector<double> features(task.features.size() * kTileLanes), rewards(kTileLanes);
  FeatureTile(task.features.data(), task.n_features(), states.data(), features.data());
  task.reward->EvaluateTile(step, states.data(), features.data(), actions.data(), rewards.data());
  return rewards[0];
}

}  // namespace downpour
