// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "engine/learner/learner.h"

namespace downpour {

// The tables of a run directory as CSV text: a header with names and units, "\n" line ends, numbers
// that round-trip, true/false, an empty field for NaN. `outputs` are the model's (ModelOutputs).

// A row an episode, nothing measured by a clock.
std::string EpisodesCsv(const LearnerState& state);

// A row an episode, all that a clock measured: seconds of model learning, of search and of the
// rollouts in it, GP queries a second of search, wall time of the rollouts a query (policy,
// sampling and reward included), and what a query of each output takes on one thread. What the
// prior takes is in PriorTimingCsv.
std::string TimingCsv(const std::vector<Variable>& outputs, const LearnerState& state);

// A row a step: episode, step, time, observation (E), action (A), next observation (E), noise-free
// next state (E), reward.
std::string TransitionsCsv(const Task& task, const LearnerState& state);

// A row an episode, output and hyper-parameter: lengthscales by input (of the
// reward: by feature), signal_std, noise_std, and
// the jitter that the factorisation took, a share of the signal variance (0: none).
std::string HyperparametersCsv(const Task& task, const std::vector<Variable>& outputs,
                               const LearnerState& state);

// A row an episode and output: how rollouts queried the model (PlanRecord); n is the exact model's
// number of points, changes counts the episode's outputs that were planned again.
std::string PlansCsv(const std::vector<Variable>& outputs, const LearnerState& state);

// A row an episode with a model: the likelihood and the parameters of the task's prior, which it
// must have. Nothing measured by a clock.
std::string PriorCsv(const Task& task, const LearnerState& state);

// As many rows: what a prediction of the prior took in rollouts, and its share of the threads'
// time.
std::string PriorTimingCsv(const LearnerState& state);

}  // namespace downpour
