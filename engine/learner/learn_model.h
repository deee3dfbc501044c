// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <span>
#include <vector>

#include "engine/learner/learner.h"

namespace downpour {

// The last record with a learnt policy, or nullptr.
const EpisodeRecord* LastLearnt(const LearnerState& state);

// The parameters of the task's prior in the record; empty without one.
std::span<const double> PriorParameters(const EpisodeRecord& record);

// Learns the exact model of all transitions so far, one GP an output (ModelOutputs), and fills the
// record's fields of the model: points, hyper-parameters, jitter, prior. The result does not depend
// on the number of threads. Throws Interrupted once `stop` is true.
std::vector<ExactGp> LearnModel(const Task& task, const LearnerOptions& options,
                                const LearnerState& state, const std::atomic<bool>* stop,
                                EpisodeRecord* record);

}  // namespace downpour
