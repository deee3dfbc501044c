// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/model_evaluator.h"

#include <algorithm>
#include <limits>
#include <string>
#include <utility>

#include "engine/errors.h"
#include "engine/rollout/reward.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// Lanes between two looks at `stop`: 64 tiles, which most numbers of threads divide, and which take
// some tenths of a second on a large model.
constexpr std::int64_t kSliceLanes = 64 * kTileLanes;

void Require(bool condition, const std::string& message) {
  if (!condition) throw InvalidInput("evaluator: " + message);
}

std::string Count(std::size_t n) { return std::to_string(n); }

StreamKey RolloutKey(std::uint64_t seed) { return DeriveKey(seed, StreamPurpose::kEvaluate, {}); }

}  // namespace

ModelEvaluator::ModelEvaluator(std::shared_ptr<const MultiOutputGp> model, Task task,
                               std::shared_ptr<const Policy> policy, BlockFunctions functions,
                               int rollouts, const EvaluatorOptions& options)
    : model_(std::move(model)),
      task_(std::move(task)),
      policy_(functions.policy ? nullptr : std::move(policy)),
      functions_(std::move(functions)),
      rollouts_(rollouts),
      options_(options) {
  Require(model_->n_outputs() == task_.n_states(),
          "the model has " + Count(model_->n_outputs()) +
              " outputs, must have one a state = " + Count(task_.n_states()));
  Require(model_->n_inputs() == task_.n_inputs(),
          "the model has " + Count(model_->n_inputs()) +
              " inputs, must have features + actions = " + Count(task_.n_features()) + " + " +
              Count(task_.n_actions()));
  Require(policy_ != nullptr || functions_.policy, "no policy: must be given");
  Require(task_.reward != nullptr || functions_.reward, "no reward: must be given");
  Require(task_.prior == nullptr, "the task has a prior of its dynamics: must have none");
  Require(rollouts >= 1 && rollouts <= 1'000'000,
          "rollouts = " + std::to_string(rollouts) + ": must be in [1, 1000000]");
  Require(task_.horizon >= 1 && task_.horizon <= 1'000'000,
          "horizon = " + std::to_string(task_.horizon) + ": must be in [1, 1000000]");
  Require(options.threads >= 1,
          "threads = " + std::to_string(options.threads) + ": must be at least 1");
}

double ModelEvaluator::diverged_return() const {
  return DivergedReturn(!functions_.reward && task_.reward->InUnitInterval(), task_.horizon);
}

void ModelEvaluator::CheckParameters(std::size_t size, int n_parameters) const {
  Require(n_parameters >= 1 && size % n_parameters == 0,
          Count(size) + " parameters: must be whole vectors of " + std::to_string(n_parameters));
  Require(policy_ == nullptr || n_parameters == policy_->n_parameters(),
          "parameter vectors of " + std::to_string(n_parameters) + ": the policy has " +
              (policy_ == nullptr ? "" : std::to_string(policy_->n_parameters())));
  Require(size / n_parameters <=
              static_cast<std::size_t>(std::numeric_limits<int>::max() - kTileLanes) / rollouts_,
          Count(size / n_parameters) + " parameter vectors x " + std::to_string(rollouts_) +
              " rollouts: must be less than 2^31");
}

void ModelEvaluator::Evaluate(std::span<const double> parameters, int n_parameters,
                              std::uint64_t seed, std::span<double> returns,
                              const std::atomic<bool>* stop) const {
  CheckParameters(parameters.size(), n_parameters);
  const std::size_t wanted = parameters.size() / n_parameters * rollouts_;
  Require(returns.size() == wanted,
          "room for " + Count(returns.size()) + " returns: must be " + Count(wanted));
  if (returns.empty()) return;
  if (!functions_.any()) {
    EvaluateTiles(parameters, RolloutKey(seed), returns, stop);
    return;
  }
  BlockRollouts rollouts(task_, policy_.get(), functions_, model_->factors(), options_, parameters,
                         n_parameters, rollouts_, RolloutKey(seed));
  rollouts.Run(returns, nullptr, stop);
}

// By slices, each some of the rollouts of some candidates.
void ModelEvaluator::EvaluateTiles(std::span<const double> parameters, StreamKey key,
                                   std::span<double> returns, const std::atomic<bool>* stop) const {
  Evaluator evaluator(task_, *policy_, model_->factors(), options_);
  const auto n_parameters = static_cast<std::size_t>(policy_->n_parameters());
  const auto n_lanes = static_cast<std::int64_t>(returns.size());
  std::vector<StreamKey> keys;
  std::vector<int> counts, first_rollouts;
  for (std::int64_t lane = 0; lane < n_lanes;) {
    if (stop != nullptr && *stop) throw Interrupted();
    const std::int64_t begin = lane, end = std::min(n_lanes, begin + kSliceLanes);
    counts.clear();
    first_rollouts.clear();
    while (lane < end) {
      const auto rollout = static_cast<int>(lane % rollouts_);
      first_rollouts.push_back(rollout);
      counts.push_back(static_cast<int>(std::min<std::int64_t>(rollouts_ - rollout, end - lane)));
      lane += counts.back();
    }
    keys.assign(counts.size(), key);
    evaluator.Evaluate(
        parameters.subspan(begin / rollouts_ * n_parameters, counts.size() * n_parameters), keys,
        counts, first_rollouts, returns.subspan(begin, end - begin));
  }
}

void ModelEvaluator::Rollout(std::span<const double> parameters, std::uint64_t seed,
                             const TrajectoryBuffers& trajectories,
                             const std::atomic<bool>* stop) const {
  const auto n_parameters = static_cast<int>(parameters.size());
  CheckParameters(parameters.size(), n_parameters);
  const std::size_t rollouts = rollouts_, horizon = task_.horizon;
  Require(trajectories.states.size() == rollouts * (horizon + 1) * task_.n_states() &&
              trajectories.actions.size() == rollouts * horizon * task_.n_actions() &&
              trajectories.rewards.size() == rollouts * horizon,
          "room for trajectories: must be rollouts x (horizon + 1) x states, x horizon x actions "
          "and x horizon");
  std::vector<double> returns(rollouts);
  BlockRollouts block(task_, policy_.get(), functions_, model_->factors(), options_, parameters,
                      n_parameters, rollouts_, RolloutKey(seed));
  block.Run(returns, &trajectories, stop);
}

}  // namespace downpour
