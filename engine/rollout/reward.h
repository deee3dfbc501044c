// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "engine/rollout/task.h"

namespace downpour {

// The numbers of a saturating reward (MakeSaturatingReward).
struct SaturatingParameters {
  std::vector<double> a, b;  // n_rows x F row-major, n_rows
  double width;
};

// The immediate reward (paper Eq. 1), evaluated for a tile of lanes: a black box to search,
// rollouts and the real system alike. It need be neither smooth nor continuous. A user's own is a
// class derived from this one (docs/rewards.md). Immutable: calls are thread-safe.
class Reward {
 public:
  // Larger ones, either sign, are no rewards: a rollout that gets one has diverged.
  static constexpr double kLimit = 1e6;

  virtual ~Reward() = default;
  // One line that tells people what is rewarded, with every number that rewards depend on: a run is
  // resumed only with a reward of the same description.
  virtual std::string Describe() const = 0;
  // True if every reward is in [0, 1], to rounding. search.stop_lost_causes needs that, and relaxed
  // rollouts (Evaluator::Evaluate) take the square roots of such.
  virtual bool InUnitInterval() const = 0;
  // Of a saturating reward, whose expectation has a closed form; nullptr: another kind.
  virtual const SaturatingParameters* saturating() const { return nullptr; }
  // rewards[lane] of the state to which the action of `step`, numbered from 0, led:
  //   states E x kTileLanes, their features F x kTileLanes, actions A x kTileLanes that led there;
  //   aligned, no aliasing
  // It depends on `step` and column `lane` alone. Does not allocate, does not throw.
  virtual void EvaluateTile(int step, const double* states, const double* features,
                            const double* actions, double* rewards) const = 0;
};

// Return of a rollout that has diverged: below that of any other, as rewards are in [0, 1] or
// within
// +-Reward::kLimit.
inline double DivergedReturn(bool in_unit_interval, int horizon) {
  return (in_unit_interval ? -1 : -(Reward::kLimit + 1)) * horizon;
}

// Saturating reward (paper Eq. 9) of the features f (F): exp(-|A f - b|^2 / (2 width^2)), in
// [0, 1]. `a` is n_rows x F row-major, n_rows = b.size(). A weight matrix Q = A^T A and target
// A f* = b. Its description names the features. Throws InvalidInput if a size disagrees, a number
// is not finite, or width is not > 0.
std::shared_ptr<const Reward> MakeSaturatingReward(std::span<const Variable> feature_names,
                                                   std::vector<double> a, std::vector<double> b,
                                                   double width);

// The reward of one state (E) to which `action` (A) led: the same number as in the tile. Allocates.
double ComputeReward(const Task& task, int step, std::span<const double> state,
                     std::span<const double> action);

}  // namespace downpour
