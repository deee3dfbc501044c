// SPDX-License-Identifier: Apache-2.0
#include "bench/rollout_parts.h"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <limits>
#include <numeric>
#include <variant>

#include "engine/rollout/evaluator.h"
#include "engine/rollout/reward.h"
#include "engine/rollout/tiling.h"
#include "kernels/features/features.h"
#include "kernels/gp_query/gp_query.h"
#include "kernels/philox/philox.h"
#include "kernels/transition/transition.h"

namespace downpour {
namespace {

// Hands the time since its last call to a part.
class PartClock {
 public:
  void Charge(RolloutPart part) {
    const Clock::time_point now = Clock::now();
    seconds_[part] += std::chrono::duration<double>(now - last_).count();
    last_ = now;
  }
  const PartSeconds& seconds() const { return seconds_; }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point last_ = Clock::now();
  PartSeconds seconds_ = {};
};

struct Lane {
  int candidate;
  std::uint32_t rollout;
};

std::vector<Lane> LanesOf(const KeptBatch& batch) {
  std::vector<Lane> lanes;
  for (int c = 0; c < static_cast<int>(batch.keys.size()); ++c) {
    for (int r = 0; r < batch.n_rollouts[c]; ++r) {
      lanes.push_back({c, static_cast<std::uint32_t>(batch.first_rollout[c] + r)});
    }
  }
  return lanes;
}

// One thread's tile.
class Tile {
 public:
  Tile(const Task& task, const Policy& policy, std::span<const QueryFactor> factors)
      : task_(task), policy_(policy), factors_(factors), keys0_(kTileLanes), keys1_(kTileLanes) {
    const std::size_t n_states = task.n_states();
    for (const QueryFactor& factor : factors) {
      const std::size_t bytes =
          std::visit([](const auto& f) { return GpQueryScratchBytes(f); }, factor);
      scratch_.resize(std::max(scratch_.size(), bytes));
    }
    rollouts_.resize(kTileLanes);
    parameters_.resize(policy.n_parameters() * kTileLanes);
    policy_scratch_.resize(static_cast<std::size_t>(policy.scratch_rows()) * kTileLanes);
    inputs_.resize(task.n_inputs() * kTileLanes);
    for (auto* rows : {&states_, &means_, &variances_, &normals_}) {
      rows->resize(n_states * kTileLanes);
    }
    for (auto* row : {&rewards_, &sums_, &alive_}) row->resize(kTileLanes);
  }

  // Runs n lanes from `lanes` on and writes their returns.
  void Run(const KeptBatch& batch, const Lane* lanes, int n, double* returns, PartClock* clock) {
    Pack(batch, lanes, n);
    clock->Charge(kPacking);
    policy_.PrepareTile(parameters_.data(), policy_scratch_.data());
    clock->Charge(kPolicy);
    FeatureTile(task_.features.data(), task_.n_features(), states_.data(), inputs_.data());
    clock->Charge(kFeatures);
    for (int step = 0; step < task_.horizon; ++step) {
      policy_.ActTile(step, parameters_.data(), inputs_.data(), policy_scratch_.data(),
                      inputs_.data() + task_.n_features() * kTileLanes);
      clock->Charge(kPolicy);
      Advance(static_cast<std::uint32_t>(step), n, clock);
    }
    for (int lane = 0; lane < n; ++lane) {
      returns[lane] = alive_[lane] != 0 ? sums_[lane] : -task_.horizon;
    }
  }

 private:
  void Pack(const KeptBatch& batch, const Lane* lanes, int n) {
    constexpr std::uint32_t kStartStep = std::numeric_limits<std::uint32_t>::max();
    const int n_parameters = policy_.n_parameters();
    for (int lane = 0; lane < kTileLanes; ++lane) {
      const Lane& source = lanes[lane < n ? lane : 0];
      const double* row = batch.parameters.data() + source.candidate * n_parameters;
      for (int p = 0; p < n_parameters; ++p) parameters_[p * kTileLanes + lane] = row[p];
      keys0_[lane] = batch.keys[source.candidate].word0;
      keys1_[lane] = batch.keys[source.candidate].word1;
      rollouts_[lane] = source.rollout;
    }
    NormalTile(keys0_.data(), keys1_.data(), rollouts_.data(), kStartStep, task_.n_states(),
               states_.data());
    for (int i = 0; i < task_.n_states() * kTileLanes; ++i) {
      const int e = i / kTileLanes;
      states_[i] = task_.start_mean[e] + task_.start_std[e] * states_[i];
    }
    std::fill(means_.begin(), means_.end(), 0.0);
    std::fill(variances_.begin(), variances_.end(), 0.0);
    std::fill(sums_.begin(), sums_.end(), 0.0);
    std::fill(alive_.begin(), alive_.end(), 1.0);
  }

  void Advance(std::uint32_t step, int n, PartClock* clock) {
    for (int e = 0; e < task_.n_states(); ++e) {
      std::visit(
          [&](const auto& factor) {
            GpQueryTile(factor, n, inputs_.data(), scratch_.data(), &means_[e * kTileLanes],
                        &variances_[e * kTileLanes]);
          },
          factors_[e]);
    }
    clock->Charge(kQueries);
    NormalTile(keys0_.data(), keys1_.data(), rollouts_.data(), step, task_.n_states(),
               normals_.data());
    clock->Charge(kSampling);
    for (int e = 0; e < task_.n_states(); ++e) {
      const int at = e * kTileLanes;
      const double noise = std::visit([](const auto& f) { return f.noise_variance; }, factors_[e]);
      TransitionTile(&means_[at], &variances_[at], noise, &normals_[at], 0, Evaluator::kStateLimit,
                     &states_[at], alive_.data());
    }
    clock->Charge(kTransition);
    FeatureTile(task_.features.data(), task_.n_features(), states_.data(), inputs_.data());
    clock->Charge(kFeatures);
    task_.reward->EvaluateTile(static_cast<int>(step), states_.data(), inputs_.data(),
                               inputs_.data() + task_.n_features() * kTileLanes, rewards_.data());
    for (int lane = 0; lane < kTileLanes; ++lane) sums_[lane] += rewards_[lane];
    clock->Charge(kReward);
  }

  const Task& task_;
  const Policy& policy_;
  std::span<const QueryFactor> factors_;
  AlignedVector<std::uint32_t> keys0_, keys1_, rollouts_;
  AlignedVector<double> parameters_, policy_scratch_, inputs_, states_, means_, variances_,
      normals_;
  AlignedVector<double> rewards_, sums_, alive_;
  AlignedVector<char> scratch_;
};

}  // namespace

KeptBatch::KeptBatch(const CandidateBatch& batch)
    : parameters(batch.parameters.begin(), batch.parameters.end()),
      keys(batch.keys.begin(), batch.keys.end()),
      n_rollouts(batch.n_rollouts.begin(), batch.n_rollouts.end()),
      first_rollout(batch.first_rollout.begin(), batch.first_rollout.end()) {}

int KeptBatch::TotalRollouts() const {
  return std::accumulate(n_rollouts.begin(), n_rollouts.end(), 0);
}

PartSeconds TimeRolloutParts(const Task& task, const Policy& policy,
                             std::span<const QueryFactor> factors, const KeptBatch& batch,
                             int threads, std::span<double> returns) {
  const std::vector<Lane> lanes = LanesOf(batch);
  const Tiling tiles(static_cast<int>(lanes.size()), threads);
  PartSeconds total = {};
#pragma omp parallel num_threads(threads)
  {
    Tile tile(task, policy, factors);
    PartClock clock;
#pragma omp for schedule(dynamic, 1)
    for (int i = 0; i < tiles.count(); ++i) {
      const int first = tiles.First(i);
      tile.Run(batch, lanes.data() + first, tiles.Size(i), returns.data() + first, &clock);
    }
#pragma omp critical
    for (int part = 0; part < kRolloutParts; ++part) total[part] += clock.seconds()[part];
  }
  return total;
}

}  // namespace downpour
