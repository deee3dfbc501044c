// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "engine/learner/planned_model.h"
#include "engine/rollout/evaluator.h"
#include "tools/downpour/read_run.h"
#include "tools/measure/kept_batch.h"

namespace downpour {

// How a profiled model is queried, and by what.
struct ProfileSettings {
  int lanes = 192;                   // rollouts of the batch
  std::string plan = "auto";         // or "exact"
  std::string precision = "double";  // or "single", of the exact plan
  QueryBackend backend = QueryBackend::kFused;
  PolicyKind policy = PolicyKind::kNeuralNetwork;  // of synthetic models
};

// A model with a batch of rollouts on it. What it points to must stay.
struct ProfileModel {
  int episode = 0;  // of a saved run; 0: synthetic
  int points = 0;
  const Task* task = nullptr;
  std::unique_ptr<Policy> policy;
  EvaluatorOptions rollout;
  std::vector<double> prior;  // parameters of the task's prior
  std::vector<QueryFactor> factors;
  std::vector<std::string> plans;  // one an output, "134 of 320 points, fp32"
  KeptBatch batch;
};

// A task without a system: `n_outputs` states, features of them, one action; n_inputs >= 2.
Task SyntheticTask(int n_inputs, int n_outputs);

// A model of n points of a smooth, damped motion under the task, with hyper-parameters that suit
// them; the same for the same arguments. The batch's policies are random ones.
ProfileModel SyntheticModel(const Task& task, int n, const ProfileSettings& settings);

// The model that a learnt episode was searched on, by the plan that the learner's options ask for,
// the candidates drawn round its policy.
ProfileModel LearntModel(const Task& task, const LearnerOptions& options, const LearnerState& state,
                         const EpisodeRecord& record, std::unique_ptr<Policy> policy,
                         const ProfileSettings& settings);
// The same of a run.
ProfileModel SavedModel(const ReadRun& run, const EpisodeRecord& record,
                        const ProfileSettings& settings);

}  // namespace downpour
