// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/pilco_step.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/learn_model.h"
#include "engine/pilco/expected_return.h"
#include "engine/pilco/gradient_search.h"
#include "engine/pilco/random_start.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// The task as the model's distribution of start states sees it.
Task PlannedTask(const Task& task, double start_std) {
  Task planned = task;
  planned.start_std.assign(planned.start_std.size(), start_std);
  return planned;
}

// The last policy, if there is one, and random ones.
std::vector<std::vector<double>> Starts(const Task& planned, const LearnerOptions& options,
                                        const LearnerState& state, int episode) {
  std::vector<std::vector<double>> starts;
  if (const EpisodeRecord* last = LastLearnt(state)) starts.push_back(last->policy);
  for (int i = static_cast<int>(starts.size()); i <= options.pilco.restarts; ++i) {
    const StreamKey key =
        DeriveKey(options.seed, StreamPurpose::kPilcoStart,
                  {static_cast<std::uint32_t>(episode), static_cast<std::uint32_t>(i)});
    starts.push_back(DrawPilcoStart(planned, options.policy, key));
  }
  return starts;
}

}  // namespace

void CheckPilco(const Task& task, const LearnerOptions& options) {
  const std::string with = std::string(" with learn.algorithm = pilco");
  const bool closed_form = !options.policy.make && (options.policy.kind == PolicyKind::kGp ||
                                                    options.policy.kind == PolicyKind::kLinear);
  if (!closed_form) {
    const std::string kind =
        options.policy.make ? MakePolicy(task, options.policy)->kind()
                            : kPolicyKindNames.at(static_cast<std::size_t>(options.policy.kind));
    throw InvalidInput("policy.kind = " + kind + ": must be gp or linear" + with);
  }
  if (options.learn_reward) {
    throw InvalidInput("learn.learn_reward = true: must be false" + with);
  }
  if (task.prior != nullptr) {
    throw InvalidInput("task " + task.name + ": has a prior: must have none" + with);
  }
  // One point will do to see whether the reward has an expectation.
  const std::vector<ExactGp> model(
      task.states.size(),
      ExactGp(Eigen::MatrixXd::Zero(1, task.n_inputs()), Eigen::VectorXd::Zero(1),
              {std::vector<double>(static_cast<std::size_t>(task.n_inputs()), 1.0), 1.0, 1.0}));
  ExpectedReturn(task, options.policy, model, 1);
}

void SearchByMomentMatching(const Task& task, const LearnerOptions& options,
                            const LearnerState& state, const Learner::Callbacks& callbacks,
                            const std::vector<ExactGp>& model, EpisodeRecord* record) {
  const Task planned = PlannedTask(task, options.pilco.start_std);
  const std::vector<std::vector<double>> starts = Starts(planned, options, state, record->episode);
  const int n_starts = static_cast<int>(starts.size());
  const int threads = options.rollout.threads;
  // Starts side by side need no barrier; a single one leaves its threads to pairs of outputs.
  const int threads_of_a_start = n_starts > 1 ? 1 : threads;
  const auto make_objective = [&]() -> ValueAndGradient {
    const auto objective =
        std::make_shared<ExpectedReturn>(planned, options.policy, model, threads_of_a_start);
    return [objective](std::span<const double> parameters, std::span<double> gradient) {
      const double expected = objective->Evaluate(parameters, gradient);
      for (double& slope : gradient) slope /= expected;
      return std::log(expected);  // NaN of a chain that broke off
    };
  };
  const auto progress = [&](GradientSearchProgress search) {
    search.best_value = std::exp(search.best_value);
    if (callbacks.pilco) callbacks.pilco(search);
  };
  GradientSearchResult result = SearchByGradient(
      {.bound = options.search.bound, .evaluations = options.pilco.evaluations, .threads = threads},
      starts, make_objective, progress, callbacks.stop);
  const bool warm = LastLearnt(state) != nullptr;
  for (int i = 0; i < n_starts; ++i) {
    const GradientSearchRun& run = result.runs[i];
    record->runs.push_back({.run = warm ? i : i + 1,
                            .evaluations = run.evaluations,
                            .stop = run.stop,
                            .mean_return = std::exp(run.value)});
    record->evaluations += run.evaluations;
  }
  record->predicted_return = std::exp(result.runs[result.best].value);
  record->policy = std::move(result.runs[result.best].parameters);
}

}  // namespace downpour
