// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/evaluator.h"

#include <omp.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <variant>

#include "engine/errors.h"
#include "engine/parallel_for.h"
#include "engine/rollout/flush_subnormals.h"
#include "engine/rollout/reward.h"
#include "engine/rollout/tiling.h"
#include "kernels/features/features.h"
#include "kernels/transition/transition.h"

namespace downpour {

// One tile's arrays, [variable][kTileLanes], carved from the thread's aligned scratch; it lives on
// the thread's stack for one block.
struct Evaluator::TileScratch {
  double* parameters;  // P
  double* prepared;    // the policy's scratch
  double* states;      // E
  double* inputs;      // F + A: features, then actions: the model's input is read in place
  double* means;       // E, or E + 1 with the learnt reward
  double* variances;   // as many
  double* normals;     // as many
  double* rewards;     // 1
  double* sums;        // 1
  double* alive;       // 1
  alignas(kAlignment) std::uint32_t keys0[kTileLanes];
  alignas(kAlignment) std::uint32_t keys1[kTileLanes];
  alignas(kAlignment) std::uint32_t rollouts[kTileLanes];

  static std::size_t Size(const Task& task, const Policy& policy, int n_outputs) {
    const std::size_t rows = static_cast<std::size_t>(policy.n_parameters()) +
                             policy.scratch_rows() + task.n_states() + task.n_inputs() +
                             3 * n_outputs + 3;
    return rows * kTileLanes;
  }

  // Takes parts of `memory`, which holds Size(...) doubles.
  void Carve(const Task& task, const Policy& policy, int n_outputs, double* memory) {
    const auto take = [&memory](std::size_t rows) {
      double* const part = memory;
      memory += rows * kTileLanes;
      return part;
    };
    parameters = take(policy.n_parameters());
    prepared = take(policy.scratch_rows());
    states = take(task.n_states());
    inputs = take(task.n_inputs());
    means = take(n_outputs);
    variances = take(n_outputs);
    normals = take(n_outputs);
    rewards = take(1);
    sums = take(1);
    alive = take(1);
  }
};

namespace {

// Step index of the stream that draws start states; steps of the horizon are 0, 1, ...
constexpr std::uint32_t kStartStep = 0xFFFFFFFF;

// Builds the message only when it is needed: Evaluate does not allocate.
template <typename Message>
void Require(bool condition, const Message& message) {
  if (!condition) throw InvalidInput("evaluator: " + message());
}

}  // namespace

Evaluator::Evaluator(const Task& task, const Policy& policy, std::span<const QueryFactor> factors,
                     const EvaluatorOptions& options, std::span<const double> prior)
    : task_(task), policy_(policy), options_(options), prior_(task, prior, options.threads) {
  Require(options.threads >= 1,
          [&] { return "threads = " + std::to_string(options.threads) + ": must be at least 1"; });
  SetFactors(factors);
}

void Evaluator::SetFactors(std::span<const QueryFactor> factors) {
  const int n_states = task_.n_states(), n_factors = static_cast<int>(factors.size());
  Require(n_factors == n_states || n_factors == n_states + 1, [&] {
    return std::to_string(n_factors) + " GP outputs, the task has " + std::to_string(n_states) +
           " states: must be equal, or one more for the reward";
  });
  for (int e = 0; e < n_factors; ++e) {
    const int dim = std::visit([](const auto& f) { return f.dim; }, factors[e]);
    const int wanted = e < n_states ? task_.n_inputs() : task_.n_features();
    Require(dim == wanted, [&] {
      return "GP output " + std::to_string(e) + " has " + std::to_string(dim) +
             " inputs: must be " + (e < n_states ? "features + actions" : "features") + " = " +
             std::to_string(wanted);
    });
  }
  Require(n_factors > n_states || task_.reward != nullptr,
          [] { return std::string("the task has no reward: must be known, or learnt"); });
  factors_ = factors;
  const bool in_unit_interval = !learnt_reward() && task_.reward->InUnitInterval();
  penalty_ = DivergedReturn(in_unit_interval, task_.horizon);
  block_tiles_ = std::any_of(factors.begin(), factors.end(),
                             [](const QueryFactor& factor) {
                               return std::holds_alternative<BlasFactor>(factor);
                             })
                     ? kBlasTiles
                     : 1;
  tile_size_ = TileScratch::Size(task_, policy_, n_outputs());
  scratch_size_ = block_tiles_ * tile_size_ + QueryScratch(factors, block_tiles_);
  scratch_.resize(scratch_size_ * options_.threads);
}

void Evaluator::Evaluate(std::span<const double> parameters, std::span<const StreamKey> keys,
                         std::span<const int> n_rollouts, std::span<const int> first_rollout,
                         std::span<double> returns, std::span<const CandidateGroup> groups,
                         bool relaxed) {
  const auto start = std::chrono::steady_clock::now();
  const double busy = busy_seconds_, prior = prior_.seconds();
  std::fill(part_times_.begin(), part_times_.end(), PartTimes{});
  Run({parameters, keys, n_rollouts, first_rollout, returns, nullptr, relaxed}, groups);
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
  statistics_.seconds += elapsed.count();
  statistics_.idle_seconds += options_.threads * elapsed.count() - (busy_seconds_ - busy);
  statistics_.prior_seconds += prior_.seconds() - prior;
  statistics_.diverged += std::count(returns.begin(), returns.end(), penalty_);
  statistics_.rollouts += std::ssize(returns);
  for (const PartTimes& times : part_times_) statistics_.parts += times;
}

Trajectories Evaluator::Trace(std::span<const double> parameters, std::span<const StreamKey> keys,
                              std::span<const int> n_rollouts) {
  const int n = std::accumulate(n_rollouts.begin(), n_rollouts.end(), 0);
  Trajectories trajectories(task_, n);
  std::vector<double> returns(n);
  const EvaluatorStatistics before = statistics_;
  Run({parameters, keys, n_rollouts, std::vector<int>(keys.size()), returns, &trajectories, false},
      {});
  statistics_ = before;
  return trajectories;
}

void Evaluator::Check(const Batch& batch) const {
  const std::size_t n_candidates = batch.keys.size();
  Require(batch.parameters.size() == n_candidates * policy_.n_parameters(), [&] {
    return std::to_string(batch.parameters.size()) + " parameters for " +
           std::to_string(n_candidates) + " candidates: must be " +
           std::to_string(policy_.n_parameters()) + " each";
  });
  Require(batch.n_rollouts.size() == n_candidates && batch.first_rollout.size() == n_candidates,
          [] { return std::string("keys, n_rollouts and first_rollout must have equal sizes"); });
  std::int64_t n_rollouts = 0;
  for (const int n : batch.n_rollouts) n_rollouts += n;
  Require(n_rollouts <= std::numeric_limits<int>::max() - kTileLanes, [&] {
    return std::to_string(n_rollouts) + " rollouts in a batch: must be less than 2^31";
  });
  Require(std::ssize(batch.returns) == n_rollouts, [&] {
    return "room for " + std::to_string(batch.returns.size()) + " returns: must be " +
           std::to_string(n_rollouts);
  });
}

void Evaluator::Run(const Batch& batch, std::span<const CandidateGroup> groups) {
  Check(batch);
  const std::size_t n_candidates = batch.keys.size();
  first_return_.resize(n_candidates);
  all_.resize(n_candidates);
  std::exclusive_scan(batch.n_rollouts.begin(), batch.n_rollouts.end(), first_return_.begin(), 0);
  if (groups.empty()) {
    std::iota(all_.begin(), all_.end(), 0);
    RunLeg(batch, {0, task_.horizon, all_});
    return;
  }
  Require(penalty_ == -task_.horizon, [] {
    return std::string("candidate groups: rewards must be in [0, 1], and those of this task, or ") +
           "learnt ones, may not be";
  });
  carried_.resize(std::max(carried_.size(), batch.returns.size() * task_.n_states()));
  lost_causes_.Start(groups, batch.n_rollouts, task_.horizon);
  for (;;) {
    const RolloutLeg leg = lost_causes_.Next(batch.returns);
    if (leg.candidates.empty()) return;
    RunLeg(batch, leg);
  }
}

void Evaluator::RunLeg(const Batch& batch, const RolloutLeg& leg) {
  lanes_.clear();
  for (const int c : leg.candidates) {
    for (int r = 0; r < batch.n_rollouts[c]; ++r) {
      lanes_.push_back(
          {c, static_cast<std::uint32_t>(batch.first_rollout[c] + r), first_return_[c] + r});
    }
  }
  const int n_lanes = static_cast<int>(lanes_.size());
  const std::int64_t n_steps = leg.end - leg.begin;
  statistics_.steps += n_steps * n_lanes;
  statistics_.gp_queries += n_steps * n_lanes * n_outputs();
  const auto run_block = [&](int first, int n) {
    RunBlock(batch, leg, first, n, scratch_.data() + scratch_size_ * omp_get_thread_num());
  };
  if (block_tiles_ == 1) {
    const Tiling tiles(n_lanes, options_.threads, TileUnit(factors_));
    statistics_.lane_steps += n_steps * tiles.computed_lanes();
    busy_seconds_ += TimedParallelFor(tiles.count(), options_.threads, [&](int tile) {
      run_block(tiles.First(tile), tiles.Size(tile));
    });
    return;
  }
  // As few blocks as hold them, as equal as whole tiles allow: as OpenBLAS's bits may depend on the
  // packing, it is the same for any number of threads.
  const std::int64_t n_tiles = WholeTiles(n_lanes);
  const auto n_blocks = static_cast<int>((n_tiles + block_tiles_ - 1) / block_tiles_);
  statistics_.lane_steps += n_steps * n_tiles * kTileLanes;
  busy_seconds_ += TimedParallelFor(n_blocks, options_.threads, [&](int block) {
    const int first = static_cast<int>(block * n_tiles / n_blocks) * kTileLanes;
    const int end = static_cast<int>((block + 1) * n_tiles / n_blocks) * kTileLanes;
    run_block(first, std::min(end, n_lanes) - first);
  });
}

void Evaluator::PackTile(const Batch& batch, int first, int n, TileScratch* scratch) const {
  TileScratch& s = *scratch;
  const int n_parameters = policy_.n_parameters();
  for (int lane = 0; lane < kTileLanes; ++lane) {
    // Idle lanes repeat the first: finite work whose result is dropped.
    const Lane& source = lanes_[first + (lane < n ? lane : 0)];
    const double* row =
        batch.parameters.data() + static_cast<std::size_t>(source.candidate) * n_parameters;
    for (int p = 0; p < n_parameters; ++p) s.parameters[p * kTileLanes + lane] = row[p];
    s.keys0[lane] = batch.keys[source.candidate].word0;
    s.keys1[lane] = batch.keys[source.candidate].word1;
    s.rollouts[lane] = source.rollout;
  }
  // Lanes beyond n need not be computed: these stay at what they are here.
  std::fill_n(s.means, kTileLanes * n_outputs(), 0.0);
  std::fill_n(s.variances, kTileLanes * n_outputs(), 0.0);
  std::fill_n(s.normals, kTileLanes * n_outputs(), 0.0);
  std::fill_n(s.inputs + task_.n_features() * kTileLanes, kTileLanes * task_.n_actions(), 0.0);
}

void Evaluator::StartTile(TileScratch* scratch) const {
  TileScratch& s = *scratch;
  NormalTile(kTileLanes, s.keys0, s.keys1, s.rollouts, kStartStep, task_.n_states(), s.states);
  for (int i = 0; i < task_.n_states() * kTileLanes; ++i) {
    const int e = i / kTileLanes;
    s.states[i] = task_.start_mean[e] + task_.start_std[e] * s.states[i];
  }
  std::fill_n(s.sums, kTileLanes, 0.0);
  std::fill_n(s.alive, kTileLanes, 1.0);
}

void Evaluator::LoadTile(const Batch& batch, int first, int n, TileScratch* scratch) const {
  TileScratch& s = *scratch;
  const int n_states = task_.n_states();
  for (int lane = 0; lane < kTileLanes; ++lane) {
    const int index = lanes_[first + (lane < n ? lane : 0)].index;
    for (int e = 0; e < n_states; ++e) {
      s.states[e * kTileLanes + lane] = carried_[static_cast<std::size_t>(index) * n_states + e];
    }
    s.sums[lane] = batch.returns[index];
    s.alive[lane] = batch.returns[index] == penalty_ ? 0 : 1;
  }
}

void Evaluator::SaveTile(int first, int n, const TileScratch& s) {
  const int n_states = task_.n_states();
  for (int lane = 0; lane < n; ++lane) {
    const auto at = static_cast<std::size_t>(lanes_[first + lane].index) * n_states;
    for (int e = 0; e < n_states; ++e) carried_[at + e] = s.states[e * kTileLanes + lane];
  }
}

void Evaluator::RecordTile(int step, int first, int n, const TileScratch& s,
                           Trajectories* trajectories) const {
  for (int lane = 0; lane < n; ++lane) {
    trajectories->Record(task_, lanes_[first + lane].index, step, lane, s.states, s.inputs,
                         s.rewards, s.alive);
  }
}

void Evaluator::QueryBlock(int output, int n, std::span<const TileScratch> tiles,
                           double* gp_scratch) const {
  const int at = output * kTileLanes;
  if (const auto* blas = std::get_if<BlasFactor>(&factors_[output])) {
    const TileScratch& s = tiles.front();
    BlasQuery(*blas, static_cast<int>(tiles.size()), tile_size_, s.inputs, gp_scratch, s.means + at,
              options_.use_variance ? s.variances + at : nullptr);
    return;
  }
  int before = 0;
  for (const TileScratch& s : tiles) {
    std::visit(
        [&](const auto& factor) {
          GpQueryTile(factor, TileLanes(n, before), s.inputs, gp_scratch, s.means + at,
                      options_.use_variance ? s.variances + at : nullptr);
        },
        factors_[output]);
    before += kTileLanes;
  }
}

void Evaluator::SampleTile(int output, double limit, const TileScratch& s, double* values) const {
  const int at = output * kTileLanes;
  const double noise = std::visit([](const auto& f) { return f.noise_variance; }, factors_[output]);
  TransitionTile(s.means + at, options_.use_variance ? s.variances + at : nullptr,
                 options_.predict_noise ? noise : 0.0, s.normals + at, options_.sample_clamp, limit,
                 values, s.alive);
}

void Evaluator::AdvanceTile(std::uint32_t step, int n, bool relaxed, const TileScratch& s,
                            PartClock* clock) {
  if (!prior_.empty()) prior_.Advance(n, s.inputs + task_.n_features() * kTileLanes, s.states);
  clock->Charge(kPartPrior);
  if (options_.use_variance) {
    NormalTile(n, s.keys0, s.keys1, s.rollouts, step, n_outputs(), s.normals);
  }
  if (relaxed) {
    for (int i = 0; i < n_outputs() * kTileLanes; ++i) s.normals[i] *= kRelaxedDeviation;
  }
  clock->Charge(kPartSampling);
  for (int e = 0; e < task_.n_states(); ++e) {
    SampleTile(e, kStateLimit, s, s.states + e * kTileLanes);
  }
  clock->Charge(kPartTransition);
  FeatureTile(task_.features.data(), task_.n_features(), s.states, s.inputs);
  clock->Charge(kPartFeatures);
}

void Evaluator::RewardTile(std::uint32_t step, bool relaxed, const TileScratch& s) const {
  if (learnt_reward()) {
    std::fill_n(s.rewards, kTileLanes, 0.0);
    SampleTile(task_.n_states(), Reward::kLimit, s, s.rewards);
  } else {
    task_.reward->EvaluateTile(static_cast<int>(step), s.states, s.inputs,
                               s.inputs + task_.n_features() * kTileLanes, s.rewards);
  }
  const bool takes_roots = relaxed && !learnt_reward() && task_.reward->InUnitInterval();
  for (int lane = 0; lane < kTileLanes; ++lane) {
    const double reward = s.rewards[lane];
    const bool is_reward = std::abs(reward) <= Reward::kLimit;  // false for NaN
    const double counted = takes_roots ? std::sqrt(std::max(reward, 0.0)) : reward;
    s.sums[lane] += is_reward ? counted : 0;
    s.alive[lane] = is_reward ? s.alive[lane] : 0;
  }
}

void Evaluator::RunBlock(const Batch& batch, const RolloutLeg& leg, int first, int n,
                         double* scratch) {
  const FlushSubnormals flush(!prior_.empty());
  std::array<TileScratch, kBlasTiles> all_tiles;
  const int n_tiles = WholeTiles(n);
  const std::span<TileScratch> tiles(all_tiles.data(), n_tiles);
  double* const gp_scratch = scratch + block_tiles_ * tile_size_;
  PartClock clock(part_times_.empty() ? nullptr : &part_times_[omp_get_thread_num()]);
  for (int t = 0; t < n_tiles; ++t) {
    TileScratch* const tile = &tiles[t];
    const int before = t * kTileLanes;
    tile->Carve(task_, policy_, n_outputs(), scratch + t * tile_size_);
    PackTile(batch, first + before, TileLanes(n, before), tile);
    if (leg.begin == 0) StartTile(tile);
    if (leg.begin > 0) LoadTile(batch, first + before, TileLanes(n, before), tile);
    clock.Charge(kPartPacking);
    policy_.PrepareTile(TileLanes(n, before), tile->parameters, tile->prepared);
    clock.Charge(kPartPolicy);
    FeatureTile(task_.features.data(), task_.n_features(), tile->states, tile->inputs);
    clock.Charge(kPartFeatures);
  }
  const auto record = [&](int step) {
    for (int at = 0; at < n && batch.trajectories != nullptr; at += kTileLanes) {
      RecordTile(step, first + at, TileLanes(n, at), tiles[at / kTileLanes], batch.trajectories);
    }
  };
  for (int step = leg.begin; step < leg.end; ++step) {
    for (int t = 0; t < n_tiles; ++t) {
      const TileScratch& s = tiles[t];
      policy_.ActTile(step, TileLanes(n, t * kTileLanes), s.parameters, s.inputs, s.prepared,
                      s.inputs + task_.n_features() * kTileLanes);
    }
    clock.Charge(kPartPolicy);
    record(step);
    for (int e = 0; e < task_.n_states(); ++e) QueryBlock(e, n, tiles, gp_scratch);
    clock.Charge(kPartQueries);
    for (int t = 0; t < n_tiles; ++t) {
      AdvanceTile(step, TileLanes(n, t * kTileLanes), batch.relaxed, tiles[t], &clock);
    }
    if (learnt_reward()) QueryBlock(task_.n_states(), n, tiles, gp_scratch);
    clock.Charge(kPartQueries);
    for (const TileScratch& tile : tiles) RewardTile(step, batch.relaxed, tile);
    clock.Charge(kPartReward);
  }
  record(leg.end);
  for (int lane = 0; lane < n; ++lane) {
    const TileScratch& s = tiles[lane / kTileLanes];
    const int at = lane % kTileLanes;
    batch.returns[lanes_[first + lane].index] = s.alive[at] != 0 ? s.sums[at] : penalty_;
  }
  for (int t = 0; t < n_tiles && leg.end < task_.horizon; ++t) {
    const int before = t * kTileLanes;
    SaveTile(first + before, TileLanes(n, before), tiles[t]);
  }
  clock.Charge(kPartPacking);
}

}  // namespace downpour
