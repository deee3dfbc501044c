// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/lost_causes.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <string>

#include "engine/errors.h"

namespace downpour {
namespace {

// All run so much of the horizon. Until a swing-up is done nothing tells candidates apart, and the
// better the leaders are chosen the higher is the threshold: of 0.5 to 0.8, 0.65 to 0.75 saved most
// on learnt models of pendulum and cart-pole.
constexpr double kFirstPart = 0.7;
// A leg costs a region's start: it is at least such a share of the horizon long, and ends before
// the horizon only where such a share of the batch's rollouts may be lost.
constexpr double kShortestLeg = 0.1;
constexpr double kFewestLost = 1.0 / 16;

void CheckGroups(std::span<const CandidateGroup> groups, std::span<const int> n_rollouts) {
  std::int64_t n_candidates = 0;
  for (const CandidateGroup& group : groups) {
    if (group.n_candidates < 1 || group.n_exact < 1) {
      throw InvalidInput("candidate groups: " + std::to_string(group.n_candidates) +
                         " candidates with n_exact = " + std::to_string(group.n_exact) +
                         ": both must be at least 1");
    }
    n_candidates += group.n_candidates;
  }
  if (n_candidates != std::ssize(n_rollouts)) {
    throw InvalidInput("candidate groups: " + std::to_string(n_candidates) +
                       " candidates: must be all " + std::to_string(n_rollouts.size()));
  }
  for (const int n : n_rollouts) {
    if (n < 1) {
      throw InvalidInput("candidate groups: a candidate with " + std::to_string(n) +
                         " rollouts: must be at least 1");
    }
  }
}

}  // namespace

void LostCauses::Start(std::span<const CandidateGroup> groups, std::span<const int> n_rollouts,
                       int horizon) {
  CheckGroups(groups, n_rollouts);
  groups_ = groups;
  n_rollouts_ = n_rollouts;
  horizon_ = horizon;
  leg_ = reached_ = 0;
  const std::size_t n = n_rollouts.size();
  all_.resize(n);
  std::iota(all_.begin(), all_.end(), 0);
  front_.clear();
  others_.clear();
  front_.reserve(n);
  others_.reserve(n);
  order_.reserve(n);
  can_be_lost_.resize(static_cast<std::size_t>(horizon));
  mean_.resize(n);
  upper_.resize(n);
  threshold_.resize(n);
}

RolloutLeg LostCauses::Next(std::span<const double> returns) {
  const int leg = leg_++;
  const int begin = reached_;
  if (leg == 0) {
    reached_ = std::max(1, static_cast<int>(kFirstPart * horizon_));
    return {begin, reached_, all_};
  }
  if (reached_ == horizon_) return {};
  SumReturns(returns);
  if (leg == 1) {
    SplitGroups();
    return {begin, horizon_, front_};
  }
  if (leg == 2) SetThresholds();
  DropLost();
  reached_ = NextStop();
  return {begin, reached_, others_};
}

void LostCauses::SumReturns(std::span<const double> returns) {
  const double penalty = -horizon_;
  const double left = horizon_ - reached_;
  auto value = returns.begin();
  for (std::size_t c = 0; c < n_rollouts_.size(); ++c) {
    double sum = 0, upper = 0;
    for (int r = 0; r < n_rollouts_[c]; ++r, ++value) {
      sum += *value;
      upper += *value == penalty ? penalty : *value + left;
    }
    mean_[c] = sum / n_rollouts_[c];
    upper_[c] = upper / n_rollouts_[c];
  }
}

void LostCauses::SplitGroups() {
  auto first = all_.begin();
  for (const CandidateGroup& group : groups_) {
    order_.assign(first, first + group.n_candidates);
    const auto leaders = order_.begin() + std::min(group.n_exact, group.n_candidates);
    std::nth_element(order_.begin(), leaders, order_.end(), [&](int a, int b) {
      return mean_[a] != mean_[b] ? mean_[a] > mean_[b] : a < b;
    });
    front_.insert(front_.end(), order_.begin(), leaders);
    others_.insert(others_.end(), leaders, order_.end());
    first += group.n_candidates;
  }
  std::sort(front_.begin(), front_.end());
  std::sort(others_.begin(), others_.end());
}

void LostCauses::SetThresholds() {
  auto leader = front_.begin();
  int first = 0;
  for (const CandidateGroup& group : groups_) {
    const int end = first + group.n_candidates;
    double threshold = std::numeric_limits<double>::infinity();
    for (; leader != front_.end() && *leader < end; ++leader) {
      threshold = std::min(threshold, mean_[*leader]);
    }
    std::fill(threshold_.begin() + first, threshold_.begin() + end, threshold);
    first = end;
  }
}

void LostCauses::DropLost() {
  std::erase_if(others_, [&](int c) {
    // Of the sums of H rewards and of n returns, and of rewards that round to just above 1.
    const double rounding =
        2.0 * horizon_ * (horizon_ + n_rollouts_[c]) * std::numeric_limits<double>::epsilon();
    return upper_[c] < threshold_[c] - rounding;
  });
}

int LostCauses::NextStop() {
  std::fill(can_be_lost_.begin(), can_be_lost_.end(), 0);
  for (const int c : others_) {
    // A step without reward lowers the bound by 1.
    const double steps = std::floor(std::max(0.0, upper_[c] - threshold_[c])) + 1;
    if (reached_ + steps < horizon_) {
      can_be_lost_[static_cast<std::size_t>(reached_ + steps)] += n_rollouts_[c];
    }
  }
  const double n_total = std::accumulate(n_rollouts_.begin(), n_rollouts_.end(), 0.0);
  int n = 0;
  for (int step = reached_ + 1; step < horizon_; ++step) {
    n += can_be_lost_[step];
    if (step - reached_ >= kShortestLeg * horizon_ && n >= kFewestLost * n_total) return step;
  }
  return horizon_;
}

}  // namespace downpour
