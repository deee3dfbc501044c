// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/pilco_step.h"

#include <doctest/doctest.h>

#include <atomic>
#include <cmath>

#include "engine/learner/checkpoint.h"
#include "engine/learner/csv_tables.h"
#include "engine/learner/prediction.h"
#include "tasks/registry.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

// Runs in well under a second an episode.
LearnerOptions TinyPilco() {
  LearnerOptions options = TinyOptions();
  options.algorithm = Algorithm::kPilco;
  options.policy.kind = PolicyKind::kGp;
  options.policy.points = 4;
  options.pilco.evaluations = 12;
  options.pilco.restarts = 2;
  return options;
}

TEST_CASE("PILCO: a run stopped after an episode and resumed from a file ends with the same bits") {
  const Task task = PointMassTask();
  const LearnerOptions options = TinyPilco();
  const LearnerState whole = Run(task, options);
  for (const int stop_after : {1, 2, 3}) {
    const std::string text = FormatCheckpoint(task, options, Run(task, options, {}, stop_after));
    const LearnerState resumed = Run(task, options, ParseCheckpoint(task, options, text, "file"));
    CHECK(SameBits(resumed, whole));
  }
}

TEST_CASE("PILCO: states have the same bits on 1, 2 and 5 threads, with and without restarts") {
  for (const int restarts : {0, 3}) {
    const Task task = MakeTask("pendulum");
    LearnerOptions options = TinyPilco();
    options.episodes = 3;
    options.pilco.restarts = restarts;
    options.threads = 1;
    const LearnerState one = Run(task, options);
    for (const int threads : {2, 5}) {
      options.threads = threads;
      CHECK(SameBits(Run(task, options), one));
    }
  }
}

TEST_CASE("PILCO: a point mass is brought to its target, by both kinds of policy") {
  for (const PolicyKind kind : {PolicyKind::kGp, PolicyKind::kLinear}) {
    Task task = PointMassTask();
    task.horizon = 12;
    task.start_std = {0, 0};
    LearnerOptions options = TinyPilco();
    options.policy.kind = kind;
    options.pilco.evaluations = 60;
    const LearnerState state = Run(task, options);
    const EpisodeRecord& last = state.episodes.back();
    // The mass is off target for the first half of the steps at least: it starts 1 m away.
    CHECK(last.predicted_return > 4);
    CHECK(std::abs(last.real_return - last.predicted_return) < 1);
    CHECK(state.transitions.back().next_state[1] == doctest::Approx(1).epsilon(0.3));
  }
}

TEST_CASE("PILCO: the record tells evaluations and starts, and has neither queries nor plans") {
  const Task task = PointMassTask();
  const LearnerState state = Run(task, TinyPilco());
  for (std::size_t i = 1; i < state.episodes.size(); ++i) {
    const EpisodeRecord& record = state.episodes[i];
    REQUIRE(record.runs.size() == 3);
    std::int64_t evaluations = 0;
    double best = 0;
    for (const RunRecord& run : record.runs) {
      evaluations += run.evaluations;
      best = std::max(best, run.mean_return);
    }
    // The first learnt episode has no last policy to begin with, run 0.
    CHECK(record.runs[0].run == (i == 1 ? 1 : 0));
    CHECK(record.evaluations == evaluations);
    CHECK(record.predicted_return == best);
    CHECK(record.gp_queries == 0);
    CHECK(record.diverged == 0);
    CHECK((std::isnan(record.lane_fill) && std::isnan(record.idle_share)));
    CHECK((record.plans.empty() && record.query_nanoseconds.empty()));
    CHECK(record.rollout_seconds == 0);
    CHECK((record.hyperparameters.size() == 2 && record.jitter.size() == 2));
    CHECK(std::isnan(RolloutNanosecondsPerQuery(record)));
  }
  const std::string csv = TimingCsv(task.states, state);
  const auto commas = [&](std::size_t from) {
    return std::count(csv.begin() + from, csv.begin() + csv.find('\n', from), ',');
  };
  const std::size_t random_row = csv.find('\n') + 1;
  CHECK(commas(csv.find('\n', random_row) + 1) == commas(random_row));
  CHECK(PlansCsv(task.states, state).find('\n') == PlansCsv(task.states, state).size() - 1);
}

TEST_CASE("PILCO: the search starts at the last policy, too") {
  const Task task = PointMassTask();
  LearnerOptions options = TinyPilco();
  options.pilco.restarts = 0;
  options.episodes = 3;
  const LearnerState state = Run(task, options, {}, 2);
  const EpisodeRecord next = Run(task, options, state).episodes[2];
  CHECK(next.runs.size() == 1);
  LearnerState other = state;
  other.episodes.back().policy[0] += 0.1;
  CHECK_FALSE(SameBits(Run(task, options, other).episodes[2].policy, next.policy));
}

TEST_CASE("PILCO: a policy is predicted by rollouts, too") {
  const Task task = PointMassTask();
  const LearnerOptions options = TinyPilco();
  const LearnerState state = Run(task, options);
  const Learner learner(task, options, state);
  const Prediction prediction = PredictEpisode(task, options, learner.policy(), state.transitions,
                                               state.episodes.back(), 100);
  CHECK(prediction.n_diverged == 0);
  CHECK(std::abs(prediction.mean_return - state.episodes.back().predicted_return) < 2);
}

TEST_CASE("PILCO: the spread of starts is the option's, not the task's") {
  Task task = PointMassTask();
  LearnerOptions options = TinyPilco();
  options.episodes = 2;
  const EpisodeRecord narrow = Run(task, options).episodes[1];
  options.pilco.start_std = 0.5;
  CHECK_FALSE(SameBits(Run(task, options).episodes[1].policy, narrow.policy));
}

TEST_CASE("PILCO: stop ends the search, the state is as it was") {
  const Task task = PointMassTask();
  Learner learner(task, TinyPilco());
  learner.RunEpisode({});
  std::atomic<bool> stop = false;
  Learner::Callbacks callbacks;
  callbacks.stop = &stop;
  int calls = 0;
  callbacks.pilco = [&](const GradientSearchProgress& progress) {
    CHECK(progress.evaluations == ++calls);
    stop = calls >= 3;
  };
  CHECK_THROWS_AS(learner.RunEpisode(callbacks), Interrupted);
  CHECK(learner.state().episodes.size() == 1);
}

TEST_CASE("PILCO: progress ends with the expected return of the record") {
  Learner learner(PointMassTask(), TinyPilco());
  learner.RunEpisode({});
  double best = 0;
  Learner::Callbacks callbacks;
  callbacks.pilco = [&](const GradientSearchProgress& progress) { best = progress.best_value; };
  CHECK(learner.RunEpisode(callbacks).predicted_return == best);
}

TEST_CASE("PILCO: what it has no closed form for is refused") {
  const auto error = [](const std::function<void(LearnerOptions&, Task&)>& change) {
    LearnerOptions options = TinyPilco();
    Task task = PointMassTask();
    change(options, task);
    return ErrorOf<InvalidInput>([&] { Learner(task, options); });
  };
  CHECK(error([](auto& o, auto&) { o.policy.kind = PolicyKind::kNeuralNetwork; }) ==
        "policy.kind = nn: must be gp or linear with learn.algorithm = pilco");
  CHECK(error([](auto& o, auto&) { o.policy.kind = PolicyKind::kDmp; }) ==
        "policy.kind = dmp: must be gp or linear with learn.algorithm = pilco");
  CHECK(error([](auto& o, auto&) { o.learn_reward = true; }) ==
        "learn.learn_reward = true: must be false with learn.algorithm = pilco");
  CHECK(error([](auto& o, auto&) { o.pilco.restarts = -1; }) ==
        "pilco.restarts = -1: must be in [0, 1000]");
  CHECK(error([](auto& o, auto&) { o.pilco.evaluations = 0; }) ==
        "pilco.evaluations = 0: must be in [1, 1000000]");
  CHECK(error([](auto& o, auto&) { o.pilco.start_std = std::nan(""); }) ==
        "pilco.start_std = nan: must be in [0, 1000]");
  class One : public Reward {
   public:
    std::string Describe() const override { return "1"; }
    bool InUnitInterval() const override { return true; }
    void EvaluateTile(int, const double*, const double*, const double*,
                      double* rewards) const override {
      std::fill_n(rewards, kTileLanes, 1.0);
    }
  };
  CHECK(Contains(error([](auto&, auto& t) { t.reward = std::make_shared<One>(); }),
                 "the reward must be a saturating one"));
}

TEST_CASE("PILCO: a run of another algorithm is not resumed, nor with other PILCO options") {
  const Task task = PointMassTask();
  LearnerOptions pilco = TinyPilco();
  LearnerOptions rollouts = pilco;
  rollouts.algorithm = Algorithm::kBlackDrops;
  const auto resume = [&](const LearnerOptions& made, const LearnerOptions& now) {
    const std::string text = FormatCheckpoint(task, made, {});
    return ErrorOf<InvalidInput>([&] { ParseCheckpoint(task, now, text, "file"); });
  };
  CHECK(resume(pilco, pilco).empty());
  CHECK(resume(pilco, rollouts) ==
        "file: the run was made with learn.algorithm = \"pilco\", the configuration says "
        "\"black-drops\": must be equal to resume");
  CHECK(resume(rollouts, pilco) ==
        "file: the run was made with learn.algorithm = \"black-drops\", the configuration says "
        "\"pilco\": must be equal to resume");
  LearnerOptions other = pilco;
  other.pilco.restarts = 7;
  CHECK(resume(pilco, other) ==
        "file: the run was made with pilco.restarts = 2, the configuration says 7: must be equal "
        "to resume");
  other = pilco;
  other.search.evaluations = 777;  // which it does not use
  CHECK(resume(pilco, other).empty());
}

}  // namespace
}  // namespace downpour
