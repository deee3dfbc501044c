// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "engine/gp/gp_model.h"
#include "engine/gp/query_plan.h"
#include "engine/learner/algorithm.h"
#include "engine/learner/rollout_helpers.h"
#include "engine/pilco/gradient_search.h"
#include "engine/rollout/evaluator.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"
#include "engine/search/policy_search.h"

namespace downpour {

// Learning of the free parameters of a prior (Task::prior).
struct PriorFitOptions {
  // Parameters that a start may try, each with hyper-parameters of its own; [1, 10000]. There is
  // one start at the last episode's parameters and as many random ones as GpFitOptions::restarts.
  int evaluations = 100;
};

// PILCO's search (docs/pilco.md). The bound of policy parameters is PolicySearchOptions::bound.
struct PilcoOptions {
  int restarts = 2;       // random starts besides the last policy; [0, 1000]
  int evaluations = 300;  // of value and gradient that a start may take; [1, 1000000]
  // Std of every state variable at the start of an episode, as the model has it; [0, 1000]. The
  // authors' 0.1; the real system keeps Task::start_std.
  double start_std = 0.1;
};

struct LearnerOptions {
  // PILCO uses neither `plan`, `prior`, `rollout` (but for predictions) nor, of `search`, more than
  // the bound.
  Algorithm algorithm = Algorithm::kBlackDrops;
  int episodes = 15;        // random ones included; [2, 1000]
  int random_episodes = 1;  // [1, 999], less than episodes
  bool until_solved = false;
  // The reward is unknown: a GP on the features of the state learns it from observed rewards (paper
  // section IV-B) and rollouts sample it. Tasks have a default of their own (Task::learn_reward).
  bool learn_reward = false;
  PolicyOptions policy;
  std::uint64_t seed = 0;
  int threads = 0;  // 0: all cores
  GpFitOptions model;
  PriorFitOptions prior;
  QueryPlanOptions plan;
  PolicySearchOptions search;
  EvaluatorOptions rollout;
  PilcoOptions pilco;
};

// One step on the real system. Observed values carry the observation noise; `next_state` of the
// noise-free pair is kept for the solved test and the plots.
struct Transition {
  int episode = 0;
  int step = 0;
  std::vector<double> observation;       // (E) before the action
  std::vector<double> action;            // (A)
  std::vector<double> next_observation;  // (E)
  std::vector<double> next_state;        // (E) noise-free; as measured on a measured system
  double reward = 0;                     // of next_state
};

// What bits depend on besides task and options: the instruction set that our kernels run on
// (SimdTargetName) and the kernel family of OpenBLAS (BlasCoreName).
struct Platform {
  std::string simd_target;
  std::string blas_core;
};

// The plan of one output (engine/gp/query_plan.h).
struct PlanRecord {
  QueryBackend backend = QueryBackend::kFused;
  int points = 0;  // of the factor; fewer than the data: compressed
  bool single_precision = false;
  double tau = 0;             // of the compression; 0: none
  double relative_cost = 1;   // modelled, exact fp64 = 1
  double variance_error = 0;  // worst seen, |error| / (variance + noise variance); by BLAS: the
                              // difference from the fused kernel's exact fp64
  bool operator==(const PlanRecord&) const = default;
  double mean_error = 0;  // worst seen, |error| / sqrt(variance + noise variance)
};

// What became of the task's prior in an episode.
struct PriorRecord {
  std::vector<double> parameters;  // learnt values of DynamicsPrior::parameters
  double log_likelihood = 0;       // of the residuals' model: the sum over the state variables
  int evaluations = 0;             // parameters tried
  // Measured by a clock over the search: of one prediction, and its share of threads x
  // rollout_seconds.
  double step_nanoseconds = 0;
  double search_share = 0;
};

// How an episode ended: whole; by the system, early; or aborted, kAborted and then the step and
// why.
inline constexpr const char* kComplete = "complete";
inline constexpr const char* kDone = "done";
inline constexpr const char* kAborted = "aborted";

struct EpisodeRecord {
  int episode = 0;  // from 1
  bool random = false;
  double interaction_seconds = 0;  // so far
  int points = 0;                  // the model was learnt from; 0 for a random episode
  double model_seconds = 0;
  double search_seconds = 0;
  double rollout_seconds = 0;  // of search_seconds: wall time of the rollouts, all threads
  // Rollouts; by PILCO evaluations of value and gradient, and all else about rollouts and queries
  // is 0, NaN or empty.
  std::int64_t evaluations = 0;
  std::int64_t gp_queries = 0;
  std::int64_t diverged = 0;
  // Rollouts / lanes of the vectors they were packed in, (0, 1]; NaN for a random episode. Depends
  // on which thread took what, as the next does.
  double lane_fill = 0;
  // Of threads x rollout_seconds, what threads spent without a tile; NaN for a random episode.
  double idle_share = 0;
  double predicted_return = 0;  // NaN for a random episode; by PILCO the expected return
  double real_return = 0;
  bool solved = false;
  int steps = 0;                    // on the system: H if complete, else at least one
  std::string outcome = kComplete;  // or kDone, or kAborted + " at step 3: no answer ..."
  std::vector<double> policy;       // (P), empty for a random episode
  // One an output (ModelOutputs), as jitter, and plans and query_nanoseconds unless by PILCO; empty
  // for a random episode.
  std::vector<Hyperparameters> hyperparameters;
  // Added to the diagonal of K, in units of signal_std^2; mostly 0 (gp_model.h).
  std::vector<double> jitter;
  // How the rollouts queried each output at the end of the search.
  std::vector<PlanRecord> plans;
  int plan_changes = 0;  // outputs planned again during the search
  // ns of one query of mean and variance by these plans on one thread, measured after the search.
  std::vector<double> query_nanoseconds;
  std::vector<RunRecord> runs;       // of the search; by PILCO one a start, 0: from the last policy
  std::optional<PriorRecord> prior;  // of an episode with a model, if the task has a prior
  Platform platform;
};

// True if the episode was aborted.
bool Aborted(const EpisodeRecord& record);

// What the model predicts, as names and units: the state variables and, if it is learnt, "reward".
std::vector<Variable> ModelOutputs(const Task& task, const LearnerOptions& options);

// Wall time of the search's rollouts, all threads, a GP query in ns: policy, sampling and reward
// are in it. NaN for an episode without rollouts.
double RolloutNanosecondsPerQuery(const EpisodeRecord& record);

// The exact model that a learnt episode's policy was searched on, one GP an output: that of the
// transitions of earlier episodes with the record's hyper-parameters.
std::vector<ExactGp> EpisodeModel(const Task& task, const std::vector<Transition>& transitions,
                                  const EpisodeRecord& record);

// All that the next episode depends on; what a checkpoint holds.
struct LearnerState {
  std::vector<EpisodeRecord> episodes;
  std::vector<Transition> transitions;
};

// The Black-DROPS loop (paper Alg. 1), which is PILCO's too but for the search. An episode depends
// only on (task, options except threads, state, platform), so a run that stops between episodes and
// goes on ends with the same bits if two conditions hold: all episodes run on one SIMD target and
// on one kernel family of OpenBLAS. Records tell both; PlatformDifference (platform.h) compares
// them.
class Learner {
 public:
  struct Callbacks {
    std::function<void(const std::string& phase)> phase;  // "model", "search", "execute"
    // `batch`: of the rollouts since the last call, a generation's.
    std::function<void(const PolicySearchProgress&, const EvaluatorStatistics& batch)> search;
    // The same by PILCO, after every evaluation; from any thread, one call at a time.
    std::function<void(const GradientSearchProgress&)> pilco;
    const std::atomic<bool>* stop = nullptr;
    RolloutHelpers* helpers = nullptr;  // that share in the search's rollouts, if any
  };

  // Throws InvalidInput if an option is out of range or the task is inconsistent, or if
  // search.stop_lost_causes is on and rewards may leave [0, 1], as learnt ones may, or as
  // CheckPilco does (pilco_step.h).
  Learner(Task task, LearnerOptions options, LearnerState state = {});

  bool done() const;  // all episodes run, or solved with until_solved
  // Runs the next episode and appends it to state(); on a measured system also one that was aborted
  // after its first step. Throws, state() unchanged: Interrupted if callbacks.stop became true,
  // SystemFailure if a measured system failed before its first step.
  const EpisodeRecord& RunEpisode(const Callbacks& callbacks);

  const Task& task() const { return task_; }
  const LearnerOptions& options() const { return options_; }
  const LearnerState& state() const { return state_; }
  const Policy& policy() const { return *policy_; }

 private:
  void LearnPolicy(const Callbacks& callbacks, EpisodeRecord* record) const;

  Task task_;
  LearnerOptions options_;
  LearnerState state_;
  std::unique_ptr<Policy> policy_;
  std::unique_ptr<System> system_;
};

}  // namespace downpour
