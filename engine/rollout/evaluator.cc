// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/evaluator.h"

#include <omp.h>

#include <algorithm>
#include <limits>
#include <string>

#include "engine/errors.h"
#include "engine/rollout/one_lane.h"
#include "kernels/features/features.h"
#include "kernels/reward/reward.h"
#include "kernels/transition/transition.h"

namespace downpour {

// One thread's arrays, [variable][kTileLanes], carved from one aligned block; it lives on the
// thread's stack for one tile.
struct Evaluator::TileScratch {
  double* parameters;  // P
  double* states;      // E
  double* inputs;      // F + A: features, then actions: the model's input is read in place
  double* means;       // E
  double* variances;   // E
  double* normals;     // E
  double* rewards;     // 1
  double* sums;        // 1
  double* alive;       // 1
  double* gp;          // GpQueryScratchSize of the largest factor
  alignas(kAlignment) std::uint32_t keys0[kTileLanes];
  alignas(kAlignment) std::uint32_t keys1[kTileLanes];
  alignas(kAlignment) std::uint32_t rollouts[kTileLanes];

  static std::size_t Size(const Task& task, int n_parameters, std::size_t gp_size) {
    const std::size_t rows = n_parameters + 4 * task.n_states() + task.n_inputs() + 3;
    return rows * kTileLanes + gp_size;
  }

  // Parts of `block`, which holds Size(...) doubles.
  TileScratch(const Task& task, int n_parameters, double* block) {
    const auto take = [&block](std::size_t rows) {
      double* const part = block;
      block += rows * kTileLanes;
      return part;
    };
    const std::size_t n_states = task.n_states();
    parameters = take(n_parameters);
    states = take(n_states);
    inputs = take(task.n_inputs());
    means = take(n_states);
    variances = take(n_states);
    normals = take(n_states);
    rewards = take(1);
    sums = take(1);
    alive = take(1);
    gp = block;
  }
};

namespace {

// Step index of the stream that draws start states; steps of the horizon are 0, 1, ...
constexpr std::uint32_t kStartStep = 0xFFFFFFFF;

std::size_t LargestGpScratch(const std::vector<GpFactor>& factors) {
  std::size_t size = 0;
  for (const GpFactor& factor : factors) size = std::max(size, GpQueryScratchSize(factor));
  return size;
}

// Builds the message only when it is needed: Evaluate does not allocate.
template <typename Message>
void Require(bool condition, const Message& message) {
  if (!condition) throw InvalidInput("evaluator: " + message());
}

}  // namespace

Evaluator::Evaluator(const Task& task, const Policy& policy, const std::vector<GpFactor>& factors,
                     const EvaluatorOptions& options)
    : task_(task), policy_(policy), factors_(factors), options_(options) {
  Require(static_cast<int>(factors.size()) == task.n_states(), [&] {
    return std::to_string(factors.size()) + " GP outputs, the task has " +
           std::to_string(task.n_states()) + " states: must be equal";
  });
  for (const GpFactor& factor : factors) {
    Require(factor.dim == task.n_inputs(), [&] {
      return "a GP has " + std::to_string(factor.dim) +
             " inputs: must be features + actions = " + std::to_string(task.n_inputs());
    });
  }
  Require(options.threads >= 1,
          [&] { return "threads = " + std::to_string(options.threads) + ": must be at least 1"; });
  scratch_size_ = TileScratch::Size(task, policy.n_parameters(), LargestGpScratch(factors));
  scratch_.resize(scratch_size_ * options.threads);
}

void Evaluator::Evaluate(std::span<const double> parameters, std::span<const StreamKey> keys,
                         std::span<const int> n_rollouts, std::span<const int> first_rollout,
                         std::span<double> returns) {
  const int n_candidates = static_cast<int>(keys.size());
  Require(parameters.size() == keys.size() * policy_.n_parameters(), [&] {
    return std::to_string(parameters.size()) + " parameters for " + std::to_string(n_candidates) +
           " candidates: must be " + std::to_string(policy_.n_parameters()) + " each";
  });
  Require(n_rollouts.size() == keys.size() && first_rollout.size() == keys.size(),
          [] { return std::string("keys, n_rollouts and first_rollout must have equal sizes"); });
  std::int64_t n_rollouts_total = 0;
  for (const int n : n_rollouts) n_rollouts_total += n;
  Require(n_rollouts_total <= std::numeric_limits<int>::max() - kTileLanes, [&] {
    return std::to_string(n_rollouts_total) + " rollouts in a batch: must be less than 2^31";
  });
  lanes_.clear();
  for (int c = 0; c < n_candidates; ++c) {
    for (int r = 0; r < n_rollouts[c]; ++r) {
      lanes_.push_back({c, static_cast<std::uint32_t>(first_rollout[c] + r)});
    }
  }
  const int n_lanes = static_cast<int>(lanes_.size());
  Require(returns.size() == lanes_.size(), [&] {
    return "room for " + std::to_string(returns.size()) + " returns: must be " +
           std::to_string(n_lanes);
  });
  const int n_tiles = (n_lanes + kTileLanes - 1) / kTileLanes;
#pragma omp parallel for schedule(dynamic, 1) num_threads(options_.threads)
  for (int tile = 0; tile < n_tiles; ++tile) {
    TileScratch scratch(task_, policy_.n_parameters(),
                        scratch_.data() + scratch_size_ * omp_get_thread_num());
    const int first = tile * kTileLanes;
    RunTile(parameters, keys, first, std::min(kTileLanes, n_lanes - first), &scratch,
            returns.data() + first);
  }
  const double penalty = -task_.horizon;
  statistics_.diverged += std::count(returns.begin(), returns.end(), penalty);
  statistics_.rollouts += n_lanes;
  statistics_.lanes += static_cast<std::int64_t>(n_tiles) * kTileLanes;
  statistics_.gp_queries += static_cast<std::int64_t>(n_lanes) * task_.horizon * task_.n_states();
}

void Evaluator::PackTile(std::span<const double> parameters, std::span<const StreamKey> keys,
                         int first, int n, TileScratch* scratch) const {
  TileScratch& s = *scratch;
  const int n_parameters = policy_.n_parameters();
  for (int lane = 0; lane < kTileLanes; ++lane) {
    // Idle lanes repeat the first: finite work whose result is dropped.
    const Lane& source = lanes_[first + (lane < n ? lane : 0)];
    const double* row =
        parameters.data() + static_cast<std::size_t>(source.candidate) * n_parameters;
    for (int p = 0; p < n_parameters; ++p) s.parameters[p * kTileLanes + lane] = row[p];
    s.keys0[lane] = keys[source.candidate].word0;
    s.keys1[lane] = keys[source.candidate].word1;
    s.rollouts[lane] = source.rollout;
  }
  NormalTile(s.keys0, s.keys1, s.rollouts, kStartStep, task_.n_states(), s.states);
  for (int e = 0; e < task_.n_states(); ++e) {
    for (int lane = 0; lane < kTileLanes; ++lane) {
      double& state = s.states[e * kTileLanes + lane];
      state = task_.start_mean[e] + task_.start_std[e] * state;
    }
  }
  std::fill_n(s.sums, kTileLanes, 0.0);
  std::fill_n(s.alive, kTileLanes, 1.0);
  FeatureTile(task_.features.data(), task_.n_features(), s.states, s.inputs);
}

void Evaluator::StepTile(std::uint32_t step, const TileScratch& s) const {
  const int n_states = task_.n_states();
  policy_.ActTile(s.parameters, s.inputs, s.inputs + task_.n_features() * kTileLanes);
  for (int e = 0; e < n_states; ++e) {
    GpQueryTile(factors_[e], s.inputs, s.gp, s.means + e * kTileLanes,
                options_.use_variance ? s.variances + e * kTileLanes : nullptr);
  }
  if (options_.use_variance) NormalTile(s.keys0, s.keys1, s.rollouts, step, n_states, s.normals);
  for (int e = 0; e < n_states; ++e) {
    const int at = e * kTileLanes;
    TransitionTile(s.means + at, options_.use_variance ? s.variances + at : nullptr,
                   options_.predict_noise ? factors_[e].noise_variance : 0.0, s.normals + at,
                   options_.sample_clamp, kStateLimit, s.states + at, s.alive);
  }
  FeatureTile(task_.features.data(), task_.n_features(), s.states, s.inputs);
  const SaturatingReward& reward = task_.reward;
  SaturatingRewardTile(reward.n_rows, task_.n_features(), reward.a.data(), reward.b.data(),
                       reward.width, s.inputs, s.rewards);
  for (int lane = 0; lane < kTileLanes; ++lane) s.sums[lane] += s.rewards[lane];
}

void Evaluator::RunTile(std::span<const double> parameters, std::span<const StreamKey> keys,
                        int first, int n, TileScratch* scratch, double* returns) const {
  PackTile(parameters, keys, first, n, scratch);
  for (int step = 0; step < task_.horizon; ++step) StepTile(step, *scratch);
  for (int lane = 0; lane < n; ++lane) {
    returns[lane] = scratch->alive[lane] != 0 ? scratch->sums[lane] : -task_.horizon;
  }
}

void ComputeFeatures(const Task& task, std::span<const double> state, std::span<double> features) {
  const AlignedVector<double> states = ToOneLane(state);
  AlignedVector<double> tile(features.size() * kTileLanes);
  FeatureTile(task.features.data(), task.n_features(), states.data(), tile.data());
  FromOneLane(tile, features);
}

double ComputeReward(const Task& task, std::span<const double> state) {
  std::vector<double> features(task.n_features());
  ComputeFeatures(task, state, features);
  const AlignedVector<double> tile = ToOneLane(features);
  AlignedVector<double> rewards(kTileLanes);
  const SaturatingReward& reward = task.reward;
  SaturatingRewardTile(reward.n_rows, task.n_features(), reward.a.data(), reward.b.data(),
                       reward.width, tile.data(), rewards.data());
  return rewards[0];
}

}  // namespace downpour
