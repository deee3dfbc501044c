// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/rollout_objective.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <vector>

#include "engine/gp/blas_query.h"
#include "engine/gp/gp_model.h"
#include "engine/learner/plan_probes.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

// The point mass with a model of a few made-up points, and a policy of one hidden unit.
struct Subject {
  Task task = PointMassTask();
  std::unique_ptr<Policy> policy = MakePolicy(task, {.hidden_units = {1}});
  std::vector<QueryFactor> factors = Factors(1);

  static ExactGp Gp(double scale) {
    Eigen::MatrixXd inputs(6, 3);
    FillUniforms({1, 2}, 0, inputs.data(), 18);
    return ExactGp(inputs, scale * (inputs.col(0) - inputs.col(2)), {{1, 1, 1}, 0.5, 0.1});
  }
  static std::vector<QueryFactor> Factors(double scale) {
    return std::vector<QueryFactor>(2, Gp(scale).Pack());
  }
};

// Some candidates and the returns of an objective for them.
struct Candidates {
  std::vector<double> parameters = std::vector<double>(20 * 5);
  std::vector<StreamKey> keys = std::vector<StreamKey>(20, {3, 4});
  std::vector<int> n_rollouts = std::vector<int>(20, 2), first_rollout = std::vector<int>(20, 0);

  Candidates() { FillNormals({5, 6}, 0, parameters.data(), parameters.size()); }
  template <typename Objective>
  std::vector<double> Returns(const Objective& objective, bool relaxed = false) const {
    std::vector<double> returns(40);
    objective(CandidateBatch{20, parameters, keys, n_rollouts, first_rollout, {}, relaxed},
              returns);
    return returns;
  }
};

TEST_CASE("rollout_objective: every thread's own objective returns what the common one does") {
  const Subject subject;
  RolloutObjective objective(subject.task, *subject.policy, subject.factors, {.threads = 3});
  REQUIRE(objective.own_objectives().size() == 3);
  const auto common = [&](const CandidateBatch& batch, std::span<double> returns) {
    objective.Evaluate(batch, returns);
  };
  const Candidates candidates;
  const std::vector<double> before = candidates.Returns(common);
  CHECK(*std::max_element(before.begin(), before.end()) > 0);
  for (const BatchObjective& own : objective.own_objectives()) {
    CHECK(candidates.Returns(own) == before);
  }
  // Other factors reach all of them.
  const std::vector<QueryFactor> others = Subject::Factors(-1);
  objective.SetFactors(others);
  const std::vector<double> after = candidates.Returns(common);
  CHECK(after != before);
  for (const BatchObjective& own : objective.own_objectives()) {
    CHECK(candidates.Returns(own) == after);
  }
  // Relaxed ones too.
  const std::vector<double> relaxed = candidates.Returns(common, true);
  CHECK(relaxed != after);
  for (const BatchObjective& own : objective.own_objectives()) {
    CHECK(candidates.Returns(own, true) == relaxed);
  }
  CHECK(objective.Statistics(0).rollouts == 12 * 40);
}

TEST_CASE("rollout_objective: one thread has none of its own, nor has OpenBLAS") {
  const Subject subject;
  CHECK(RolloutObjective(subject.task, *subject.policy, subject.factors, {.threads = 1})
            .own_objectives()
            .empty());
  const std::vector<QueryFactor> blas(2, MakeBlasFactor(Subject::Gp(1)));
  CHECK(RolloutObjective(subject.task, *subject.policy, blas, {.threads = 2})
            .own_objectives()
            .empty());
}

TEST_CASE("rollout_objective: a search is the same for any threads, and all of it is counted") {
  const Subject subject;
  PolicySearchOptions search;
  search.evaluations = 4000;
  search.concurrent = 4;
  search.population = 8;
  const std::vector<double> origin(5, 0.0);
  std::vector<double> expected;
  Eigen::MatrixXd expected_inputs;
  for (const int threads : {1, 2, 4, 5}) {
    search.threads = threads;
    RolloutObjective objective(subject.task, *subject.policy, subject.factors,
                               {.threads = threads});
    double waiting_seconds = 0;
    Eigen::MatrixXd inputs;
    const PolicySearchResult result = SearchPolicy(
        search, origin, 1, 1,
        [&](const CandidateBatch& batch, std::span<double> returns) {
          objective.Evaluate(batch, returns);
        },
        [&](const PolicySearchProgress& now) {
          waiting_seconds = now.waiting_seconds;
          if (inputs.size() > 0) return;
          inputs = NextInputs(now.runs, subject.task.n_inputs(), objective.evaluator());
        },
        nullptr, objective.own_objectives());
    if (expected.empty()) {
      expected = result.parameters;
      expected_inputs = inputs;
    }
    CHECK(result.parameters == expected);
    // Four runs' 32 candidates, a rollout each.
    CHECK(inputs.rows() == 32 * subject.task.horizon);
    CHECK(inputs == expected_inputs);
    const EvaluatorStatistics statistics = objective.Statistics(waiting_seconds);
    CHECK(statistics.rollouts == result.evaluations);
    CHECK(statistics.gp_queries == result.evaluations * subject.task.horizon * 2);
    CHECK((waiting_seconds > 0) == (threads == 2 || threads == 4));
    CHECK(statistics.seconds > 0);
    CHECK(statistics.idle_seconds >= waiting_seconds);
    CHECK(statistics.IdleShare(threads) <= 1);
  }
}

}  // namespace
}  // namespace downpour
