// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/block_rollouts.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <variant>

#include "engine/errors.h"
#include "engine/parallel_for.h"
#include "engine/rollout/reward.h"
#include "kernels/features/features.h"
#include "kernels/transition/transition.h"

namespace downpour {
namespace {

// As in evaluator.cc: the step of the stream that draws start states.
constexpr std::uint32_t kStartStep = 0xFFFFFFFF;

}  // namespace

// One tile's arrays, [variable][kTileLanes].
struct BlockRollouts::Tile {
  double* parameters;  // P, of a Policy only, as `prepared`
  double* prepared;    // its scratch
  double* states;      // E
  double* inputs;      // F + A: features, then actions
  double* actions;     // in `inputs`
  double* mean;        // 1, as the next two
  double* variance;
  double* normals;  // E
  std::uint32_t* keys0;
  std::uint32_t* keys1;
  std::uint32_t* rollouts;
  double* rewards;
  double* sums;
  double* alive;
};

BlockRollouts::BlockRollouts(const Task& task, const Policy* policy,
                             const BlockFunctions& functions, std::span<const QueryFactor> factors,
                             const EvaluatorOptions& options, std::span<const double> parameters,
                             int n_parameters, int n_rollouts, StreamKey key)
    : task_(task),
      policy_(functions.policy ? nullptr : policy),
      functions_(functions),
      factors_(factors),
      options_(options),
      n_parameters_(n_parameters),
      n_rollouts_(n_rollouts),
      lanes_(static_cast<int>(parameters.size() / n_parameters * n_rollouts)),
      n_tiles_((lanes_ + kTileLanes - 1) / kTileLanes) {
  const std::size_t policy_rows = policy_ == nullptr ? 0 : n_parameters + policy_->scratch_rows();
  tile_size_ = (policy_rows + 2 * task.n_states() + task.n_inputs() + 2) * kTileLanes;
  const auto n_tiles = static_cast<std::size_t>(n_tiles_);
  tiles_.resize(n_tiles * tile_size_);
  streams_.resize(n_tiles * 3 * kTileLanes);
  for (auto* row : {&rewards_, &sums_}) row->assign(n_tiles * kTileLanes, 0.0);
  alive_.assign(n_tiles * kTileLanes, 1.0);
  std::size_t bytes = 0;
  for (const QueryFactor& factor : factors) {
    std::visit([&](const auto& f) { bytes = std::max(bytes, GpQueryScratchBytes(f)); }, factor);
  }
  // Whole cache lines, so that every thread's part is aligned.
  gp_scratch_size_ = (bytes + kAlignment - 1) / kAlignment * (kAlignment / sizeof(double));
  gp_scratch_.resize(gp_scratch_size_ * options.threads);
  const auto lanes = static_cast<std::size_t>(lanes_);
  state_block_.resize(lanes * task.n_states());
  feature_block_.resize(lanes * task.n_features());
  action_block_.resize(lanes * task.n_actions());
  if (functions.policy) parameter_block_.resize(lanes * n_parameters);
  ParallelFor(n_tiles_, options.threads, [&](int tile) { StartTile(tile, parameters, key); });
}

int BlockRollouts::TileLanes(int tile) const {
  return std::min(kTileLanes, lanes_ - tile * kTileLanes);
}

BlockRollouts::Tile BlockRollouts::TileAt(int tile) {
  double* memory = tiles_.data() + static_cast<std::size_t>(tile) * tile_size_;
  const auto take = [&memory](std::size_t rows) {
    double* const part = memory;
    memory += rows * kTileLanes;
    return part;
  };
  Tile t{};
  t.parameters = take(policy_ == nullptr ? 0 : n_parameters_);
  t.prepared = take(policy_ == nullptr ? 0 : policy_->scratch_rows());
  t.states = take(task_.n_states());
  t.inputs = take(task_.n_inputs());
  t.actions = t.inputs + task_.n_features() * kTileLanes;
  t.mean = take(1);
  t.variance = take(1);
  t.normals = take(task_.n_states());
  const std::size_t lane = static_cast<std::size_t>(tile) * kTileLanes;
  t.keys0 = streams_.data() + 3 * lane;
  t.keys1 = t.keys0 + kTileLanes;
  t.rollouts = t.keys1 + kTileLanes;
  t.rewards = rewards_.data() + lane;
  t.sums = sums_.data() + lane;
  t.alive = alive_.data() + lane;
  return t;
}

void BlockRollouts::StartTile(int tile, std::span<const double> parameters, StreamKey key) {
  const Tile t = TileAt(tile);
  const int first = tile * kTileLanes;
  for (int i = 0; i < kTileLanes; ++i) {
    // Idle lanes repeat the first: finite work whose result is dropped.
    const int lane = first + (i < TileLanes(tile) ? i : 0);
    t.keys0[i] = key.word0;
    t.keys1[i] = key.word1;
    t.rollouts[i] = static_cast<std::uint32_t>(lane % n_rollouts_);
    const double* const row =
        &parameters[static_cast<std::size_t>(lane / n_rollouts_) * n_parameters_];
    for (int p = 0; p < n_parameters_; ++p) {
      if (policy_ != nullptr) {
        t.parameters[p * kTileLanes + i] = row[p];
      } else {
        parameter_block_[static_cast<std::size_t>(p) * lanes_ + lane] = row[p];
      }
    }
  }
  if (policy_ != nullptr) policy_->PrepareTile(TileLanes(tile), t.parameters, t.prepared);
  std::fill_n(t.mean, kTileLanes, 0.0);
  std::fill_n(t.variance, kTileLanes, 0.0);
  NormalTile(kTileLanes, t.keys0, t.keys1, t.rollouts, kStartStep, task_.n_states(), t.states);
  for (int e = 0; e < task_.n_states(); ++e) {
    for (int i = 0; i < kTileLanes; ++i) {
      double& state = t.states[e * kTileLanes + i];
      state = task_.start_mean[e] + task_.start_std[e] * state;
    }
  }
  Gather(tile, task_.n_states(), t.states, &state_block_);
  if (functions_.features) return;
  FeatureTile(task_.features.data(), task_.n_features(), t.states, t.inputs);
  Gather(tile, task_.n_features(), t.inputs, &feature_block_);
}

void BlockRollouts::Gather(int tile, int rows, const double* from,
                           std::vector<double>* block) const {
  const std::size_t first = static_cast<std::size_t>(tile) * kTileLanes;
  for (int row = 0; row < rows; ++row) {
    std::copy_n(from + row * kTileLanes, TileLanes(tile),
                block->data() + static_cast<std::size_t>(row) * lanes_ + first);
  }
}

void BlockRollouts::Scatter(int tile, int rows, const std::vector<double>& block,
                            double* to) const {
  const std::size_t first = static_cast<std::size_t>(tile) * kTileLanes;
  const int n = TileLanes(tile);
  for (int row = 0; row < rows; ++row) {
    double* const lanes = to + row * kTileLanes;
    std::copy_n(block.data() + static_cast<std::size_t>(row) * lanes_ + first, n, lanes);
    std::fill(lanes + n, lanes + kTileLanes, lanes[0]);
  }
}

void BlockRollouts::StepTile(int step, int tile) {
  const Tile t = TileAt(tile);
  if (functions_.features) Scatter(tile, task_.n_features(), feature_block_, t.inputs);
  if (functions_.policy) {
    Scatter(tile, task_.n_actions(), action_block_, t.actions);
  } else {
    policy_->ActTile(step, TileLanes(tile), t.parameters, t.inputs, t.prepared, t.actions);
    Gather(tile, task_.n_actions(), t.actions, &action_block_);
  }
  if (options_.use_variance) {
    NormalTile(TileLanes(tile), t.keys0, t.keys1, t.rollouts, static_cast<std::uint32_t>(step),
               task_.n_states(), t.normals);
  }
  double* const scratch = gp_scratch_.data() + gp_scratch_size_ * omp_get_thread_num();
  double* const variance = options_.use_variance ? t.variance : nullptr;
  for (int e = 0; e < task_.n_states(); ++e) {
    double noise = 0;
    std::visit(
        [&](const auto& factor) {
          GpQueryTile(factor, TileLanes(tile), t.inputs, scratch, t.mean, variance);
          if (options_.predict_noise) noise = factor.noise_variance;
        },
        factors_[e]);
    TransitionTile(t.mean, variance, noise, t.normals + e * kTileLanes, options_.sample_clamp,
                   Evaluator::kStateLimit, t.states + e * kTileLanes, t.alive);
  }
  Gather(tile, task_.n_states(), t.states, &state_block_);
  if (!functions_.features) {
    FeatureTile(task_.features.data(), task_.n_features(), t.states, t.inputs);
    Gather(tile, task_.n_features(), t.inputs, &feature_block_);
  }
  if (functions_.reward) return;
  task_.reward->EvaluateTile(step, t.states, t.inputs, t.actions, t.rewards);
  AddRewards(tile);
}

void BlockRollouts::AddRewards(int tile) {
  const Tile t = TileAt(tile);
  for (int i = 0; i < kTileLanes; ++i) {
    const bool is_reward = std::abs(t.rewards[i]) <= Reward::kLimit;  // false for NaN
    t.sums[i] += is_reward ? t.rewards[i] : 0;
    t.alive[i] = is_reward ? t.alive[i] : 0;
  }
}

void BlockRollouts::CheckFinite(const char* function, int step, int rows,
                                const std::vector<double>& block) const {
  const auto bad = std::find_if(block.begin(), block.begin() + std::ptrdiff_t{rows} * lanes_,
                                [](double x) { return !std::isfinite(x); });
  const auto at = static_cast<int>(bad - block.begin());
  if (at == rows * lanes_) return;
  throw InvalidInput(std::string(function) + ": gave " + std::to_string(*bad) + " at step " +
                     std::to_string(step) + ", lane " + std::to_string(at % lanes_) + ", column " +
                     std::to_string(at / lanes_) + ": must be finite");
}

void BlockRollouts::CallPolicy(int step) {
  if (functions_.features) {
    functions_.features(step, lanes_, state_block_.data(), feature_block_.data());
    CheckFinite("features", step, task_.n_features(), feature_block_);
  }
  if (!functions_.policy) return;
  functions_.policy(step, lanes_, parameter_block_.data(), feature_block_.data(),
                    action_block_.data());
  CheckFinite("policy", step, task_.n_actions(), action_block_);
  for (int a = 0; a < task_.n_actions(); ++a) {
    const double limit = task_.action_limits[a];
    double* const column = action_block_.data() + static_cast<std::size_t>(a) * lanes_;
    for (int lane = 0; lane < lanes_; ++lane) {
      column[lane] = std::clamp(column[lane], -limit, limit);
    }
  }
}

void BlockRollouts::CallReward(int step) {
  if (!functions_.reward) return;
  functions_.reward(step, lanes_, state_block_.data(), action_block_.data(), rewards_.data());
  for (int lane = 0; lane < lanes_; ++lane) {
    if (std::isfinite(rewards_[lane])) continue;
    throw InvalidInput("reward: gave " + std::to_string(rewards_[lane]) + " at step " +
                       std::to_string(step) + ", lane " + std::to_string(lane) +
                       ": must be finite");
  }
  for (int tile = 0; tile < n_tiles_; ++tile) AddRewards(tile);
}

void BlockRollouts::RecordStates(int time, const TrajectoryBuffers& trajectories) {
  const std::size_t n_states = task_.states.size(), times = task_.horizon + std::size_t{1};
  for (int lane = 0; lane < lanes_; ++lane) {
    double* const row = &trajectories.states[(lane * times + time) * n_states];
    for (std::size_t e = 0; e < n_states; ++e) {
      row[e] = alive_[lane] != 0 ? state_block_[e * lanes_ + lane]
                                 : std::numeric_limits<double>::quiet_NaN();
    }
  }
}

void BlockRollouts::Record(int step, const TrajectoryBuffers& trajectories) {
  RecordStates(step + 1, trajectories);
  const std::size_t n_actions = task_.actions.size(), horizon = task_.horizon;
  for (int lane = 0; lane < lanes_; ++lane) {
    const bool alive = alive_[lane] != 0;
    const std::size_t row = lane * horizon + step;
    for (std::size_t a = 0; a < n_actions; ++a) {
      trajectories.actions[row * n_actions + a] =
          alive ? action_block_[a * lanes_ + lane] : std::numeric_limits<double>::quiet_NaN();
    }
    trajectories.rewards[row] = alive ? rewards_[lane] : std::numeric_limits<double>::quiet_NaN();
  }
}

void BlockRollouts::Run(std::span<double> returns, const TrajectoryBuffers* trajectories,
                        const std::atomic<bool>* stop) {
  if (trajectories != nullptr) RecordStates(0, *trajectories);
  for (int step = 0; step < task_.horizon; ++step) {
    if (stop != nullptr && *stop) throw Interrupted();
    CallPolicy(step);
    ParallelFor(n_tiles_, options_.threads, [&](int tile) { StepTile(step, tile); });
    CallReward(step);
    if (trajectories != nullptr) Record(step, *trajectories);
  }
  const bool in_unit_interval = !functions_.reward && task_.reward->InUnitInterval();
  const double penalty = DivergedReturn(in_unit_interval, task_.horizon);
  for (int lane = 0; lane < lanes_; ++lane) {
    returns[lane] = alive_[lane] != 0 ? sums_[lane] : penalty;
  }
}

}  // namespace downpour
