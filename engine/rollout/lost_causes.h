// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "engine/candidate_group.h"

namespace downpour {

// Steps [begin, end) of all rollouts of some candidates.
struct RolloutLeg {
  int begin = 0, end = 0;
  std::span<const int> candidates;  // ascending; valid until the next leg is asked for
};

// Which candidates of a batch to run how far, so that none runs on for long that cannot be among
// the n_exact best of its group any more:
// 1. All run the first part of the horizon.
// 2. The n_exact candidates of each group that lead there run to the end. The worst of their mean
//    returns is the group's threshold.
// 3. The others run on in legs. Rewards are at most 1: before each leg those are left out whose
//    mean return would be below the threshold even with 1 for every step to come.
//
// A candidate that is left out is lost for certain: the threshold is made of complete returns only,
// as no more than the penalty for divergence is certain of a rollout under way. A rollout that has
// diverged counts with the penalty. Legs depend on returns alone, not on threads.
class LostCauses {
 public:
  // Begins a batch. The groups cover the candidates in order, n_exact >= 1; candidate c has
  // n_rollouts[c] >= 1 rollouts. Keeps both spans. Throws InvalidInput if they do not or have not.
  // Allocates if the batch is larger than all before.
  void Start(std::span<const CandidateGroup> groups, std::span<const int> n_rollouts, int horizon);
  // The next leg, given the returns so far: of each rollout the sum of rewards up to the step that
  // it reached, or the penalty -horizon. No candidates: the batch is done. Does not allocate.
  RolloutLeg Next(std::span<const double> returns);

 private:
  void SumReturns(std::span<const double> returns);
  void SplitGroups();
  void SetThresholds();
  void DropLost();
  int NextStop();

  std::span<const CandidateGroup> groups_;
  std::span<const int> n_rollouts_;
  int horizon_ = 0;
  int leg_ = 0;                    // legs given so far
  int reached_ = 0;                // step of others_
  std::vector<int> all_;           // candidates by index
  std::vector<int> front_;         // those that run to the end first
  std::vector<int> others_;        // the rest, less those that are lost
  std::vector<int> order_;         // scratch: candidates of a group
  std::vector<int> can_be_lost_;   // scratch: rollouts by the step at which they may be, at best
  std::vector<double> mean_;       // of returns so far
  std::vector<double> upper_;      // bound of the mean of complete returns
  std::vector<double> threshold_;  // of the candidate's group
};

}  // namespace downpour
