// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/learner.h"

#include <doctest/doctest.h>
#include <omp.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <set>

#include "engine/gp/process_settings.h"
#include "engine/learner/checkpoint.h"
#include "kernels/fma_peak/fma_peak.h"
#include "tasks/registry.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

std::string OptionError(const std::function<void(LearnerOptions&)>& change) {
  LearnerOptions options = PointMassOptions();
  change(options);
  return ErrorOf<InvalidInput>([&] { Learner(PointMassTask(), options); });
}

TEST_CASE(
    "learner: a run stopped after an episode and resumed from a file ends with the same bits") {
  const TemporaryDirectory directory;
  const std::filesystem::path file = directory.path() / "checkpoint.json";
  for (const char* name : {"pendulum", "cartpole"}) {
    const Task task = MakeTask(name);
    const LearnerOptions options = TinyOptions();
    const LearnerState whole = Run(task, options);
    for (const int stop_after : {1, 2}) {
      WriteCheckpoint(file, task, options, Run(task, options, {}, stop_after));
      const LearnerState resumed = Run(task, options, ReadCheckpoint(file, task, options));
      CHECK(SameBits(resumed, whole));
    }
  }
}

TEST_CASE("learner: states have the same bits on 1, 2 and 5 threads") {
  for (const char* name : {"pendulum", "cartpole"}) {
    const Task task = MakeTask(name);
    LearnerOptions options = TinyOptions();
    options.episodes = 3;
    options.threads = 1;
    const LearnerState one = Run(task, options);
    for (const int threads : {2, 5}) {
      options.threads = threads;
      CHECK(SameBits(Run(task, options), one));
    }
  }
}

TEST_CASE("learner: another seed gives another run, seed 0 is one of them") {
  const Task task = MakeTask("pendulum");
  LearnerOptions options = TinyOptions();
  std::set<double> actions;
  for (const std::uint64_t seed : {0ull, 1ull, 1ull << 32}) {
    options.seed = seed;
    actions.insert(Run(task, options, {}, 1).transitions[0].action[0]);
  }
  CHECK(actions.size() == 3);
}

TEST_CASE("learner: random actions are uniform in the limits") {
  Task task = PointMassTask();
  task.horizon = 4000;
  LearnerOptions options = TinyOptions();
  int counts[8] = {};
  for (const Transition& transition : Run(task, options, {}, 1).transitions) {
    const double eighth = (transition.action[0] / task.action_limits[0] + 1) * 4;
    ++counts[std::clamp(static_cast<int>(eighth), 0, 7)];
  }
  // Binomial(n, 1/8), five standard deviations.
  for (const int count : counts) {
    CHECK(std::abs(count - 4000 / 8.0) < 5 * std::sqrt(4000 * 7 / 64.0));
  }
}

TEST_CASE("learner: the search starts from the last policy, the model from its hyper-parameters") {
  const Task task = PointMassTask();
  LearnerOptions options = TinyOptions();
  options.model.max_evaluations = 1;
  options.model.restarts = 0;
  options.episodes = 2;
  LearnerState state = Run(task, options);
  options.episodes = 3;
  const LearnerState next = Run(task, options, state);
  LearnerState other = state;
  other.episodes.back().policy[0] += 0.1;
  CHECK_FALSE(SameBits(Run(task, options, other).episodes[2].policy, next.episodes[2].policy));
  other = state;
  other.episodes.back().hyperparameters[0].noise_std *= 2;
  CHECK_FALSE(SameBits(Run(task, options, other).episodes[2].hyperparameters[0].noise_std,
                       next.episodes[2].hyperparameters[0].noise_std));
}

TEST_CASE("learner: the model sees what was observed, never the noise-free states") {
  const Task task = PointMassTask();
  LearnerOptions options = TinyOptions();
  options.episodes = 2;
  LearnerState state = Run(task, options, {}, 1);
  const EpisodeRecord record = Run(task, options, state).episodes[1];
  LearnerState other = state;
  other.transitions[2].next_state[0] += 1;
  CHECK(SameBits(Run(task, options, other).episodes[1], record));
  other = state;
  other.transitions[2].next_observation[0] += 1;
  CHECK_FALSE(SameBits(Run(task, options, other).episodes[1], record));
}

TEST_CASE("learner: the number of OpenMP threads the program was started with changes no bit") {
  const Task task = MakeTask("pendulum");
  LearnerOptions options = TinyOptions();
  // OpenBLAS would split the factorisation of K and the eigendecomposition of C.
  options.episodes = 3;
  options.search.evaluations = 3000;
  options.threads = 1;
  const int threads = omp_get_max_threads();
  omp_set_num_threads(1);
  const LearnerState one = Run(task, options);
  omp_set_num_threads(3);
  const LearnerState three = Run(task, options);
  CHECK(omp_get_max_threads() == 3);
  omp_set_num_threads(threads);
  CHECK(SameBits(three, one));
}

TEST_CASE("learner: records tell what the episodes were") {
  const Task task = PointMassTask();
  LearnerOptions options = TinyOptions();
  options.random_episodes = 2;
  const LearnerState state = Run(task, options);
  REQUIRE(state.episodes.size() == 4);
  CHECK(state.transitions.size() == 4 * 5);
  for (int i = 0; i < 4; ++i) {
    const EpisodeRecord& record = state.episodes[i];
    CHECK(record.episode == i + 1);
    CHECK(record.random == (i < 2));
    CHECK(record.interaction_seconds == doctest::Approx((i + 1) * 0.5));
    CHECK(record.points == (i < 2 ? 0 : i * 5));
    CHECK(std::isnan(record.predicted_return) == (i < 2));
    CHECK(record.policy.size() == (i < 2 ? 0 : 10 * 2 + 10 + 10 + 1));
    CHECK(record.hyperparameters.size() == (i < 2 ? 0 : 2));
    // Rollouts x horizon x outputs.
    CHECK(record.gp_queries == record.evaluations * 5 * 2);
    CHECK(record.jitter == std::vector<double>(i < 2 ? 0 : 2));
    CHECK(std::isnan(record.lane_fill) == (i < 2));
    if (i >= 2) CHECK((record.lane_fill > 0 && record.lane_fill <= 1));
    CHECK(std::isnan(record.idle_share) == (i < 2));
    if (i >= 2) CHECK((record.idle_share >= 0 && record.idle_share < 1));
    CHECK(record.platform.simd_target == SimdTargetName());
    CHECK(record.platform.blas_core == BlasCoreName());
    double real_return = 0;
    for (int step = 0; step < 5; ++step) real_return += state.transitions[i * 5 + step].reward;
    CHECK(record.real_return == real_return);
    for (int step = 0; step < 5; ++step) {
      CHECK(std::abs(state.transitions[i * 5 + step].action[0]) <= task.action_limits[0]);
    }
  }
}

TEST_CASE("learner: a search that never fills a tile says so") {
  LearnerOptions options = TinyOptions();
  options.episodes = 2;
  options.search.population = 2;
  options.search.concurrent = 1;
  options.search.exploration = 1;
  options.search.evaluations = 100;
  options.search.final_rollouts = 1;
  const double fill = Run(PointMassTask(), options).episodes[1].lane_fill;
  // No batch has more rollouts than the final comparison's few.
  CHECK(fill > 0);
  CHECK(fill < 0.5);
}

TEST_CASE("learner: until_solved ends the run at the first solved episode") {
  Task task = PointMassTask();
  task.solved = [](std::span<const double>) { return true; };
  LearnerOptions options = TinyOptions();
  options.until_solved = true;
  CHECK(Run(task, options).episodes.size() == 1);
}

TEST_CASE("learner: a request to stop leaves the state as it was") {
  Learner learner(PointMassTask(), TinyOptions());
  learner.RunEpisode({});
  for (const char* phase_to_stop : {"model", "search"}) {
    std::atomic<bool> stop = false;
    Learner::Callbacks callbacks;
    callbacks.stop = &stop;
    callbacks.phase = [&](const std::string& phase) { stop = phase == phase_to_stop; };
    CHECK_THROWS_AS(learner.RunEpisode(callbacks), Interrupted);
    CHECK(learner.state().episodes.size() == 1);
    CHECK(learner.state().transitions.size() == 5);
  }
  std::atomic<bool> stop = false;
  Learner::Callbacks callbacks;
  callbacks.stop = &stop;
  int batches = 0;
  callbacks.search = [&](const PolicySearchProgress&, const EvaluatorStatistics&) {
    stop = true;
    ++batches;
  };
  CHECK_THROWS_AS(learner.RunEpisode(callbacks), Interrupted);
  CHECK(batches == 1);
  CHECK(learner.state().episodes.size() == 1);
  // The attempts that were stopped leave no trace in what follows.
  while (!learner.done()) learner.RunEpisode({});
  CHECK(SameBits(learner.state(), Run(PointMassTask(), TinyOptions())));
}

TEST_CASE("learner: progress tells the rollouts, lanes and idle threads of every generation") {
  LearnerOptions options = TinyOptions();
  options.threads = 2;
  Learner learner(PointMassTask(), options);
  std::int64_t rollouts = 0;
  Learner::Callbacks callbacks;
  callbacks.search = [&](const PolicySearchProgress&, const EvaluatorStatistics& batch) {
    rollouts += batch.rollouts;
    CHECK((batch.LaneFill() > 0 && batch.LaneFill() <= 1));
    CHECK((batch.IdleShare(2) >= 0 && batch.IdleShare(2) < 1));
  };
  while (!learner.done()) {
    rollouts = 0;
    const EpisodeRecord& record = learner.RunEpisode(callbacks);
    CHECK(rollouts == record.evaluations);
  }
}

TEST_CASE("learner: exploration is relaxed until there is a last policy") {
  LearnerOptions options = TinyOptions();
  options.episodes = 3;
  Learner learner(PointMassTask(), options);
  int relaxed = 0, rounds = 0;
  Learner::Callbacks callbacks;
  callbacks.search = [&](const PolicySearchProgress& progress, const EvaluatorStatistics&) {
    if (progress.runs.empty()) return;  // the final comparison
    relaxed += progress.relaxed;
    ++rounds;
  };
  for (int episode = 1; episode <= 3; ++episode) {  // the first one's actions are random
    relaxed = rounds = 0;
    learner.RunEpisode(callbacks);
    CHECK((rounds > 0) == (episode > 1));
    CHECK((relaxed > 0) == (episode == 2));
    CHECK((relaxed < rounds) == (episode > 1));
  }
}

TEST_CASE("learner: a system that breaks leaves the state as it was") {
  class Broken : public PointMass {
   public:
    void Step(std::span<const double>, std::span<double> state) override {
      state[0] = state[1] = std::numeric_limits<double>::infinity();
    }
  };
  Task task = PointMassTask();
  task.make_system = [] { return std::make_unique<Broken>(); };
  Learner learner(task, TinyOptions());
  CHECK(ErrorOf<InvalidInput>([&] { learner.RunEpisode({}); }) ==
        "episode 1, step 0: velocity = inf on the real system: must be finite");
  CHECK(learner.state().episodes.empty());
}

TEST_CASE("learner: options out of range are refused by name, value and range") {
  using O = LearnerOptions;
  CHECK(OptionError([](O& o) { o.episodes = 0; }) == "learn.episodes = 0: must be in [2, 1000]");
  CHECK(OptionError([](O& o) { o.random_episodes = 1001; }) ==
        "learn.random_episodes = 1001: must be in [1, 999]");
  for (const int random_episodes : {2, 5}) {
    CHECK(OptionError([&](O& o) {
            o.episodes = 2;
            o.random_episodes = random_episodes;
          }) == "learn.random_episodes = " + std::to_string(random_episodes) +
                    ": must be less than learn.episodes = 2");
  }
  CHECK(OptionError([](O& o) { o.policy.hidden_units = {257}; }) ==
        "policy.hidden_units = 257: must be in [1, 256]");
  CHECK(OptionError([](O& o) { o.threads = -1; }) == "learn.threads = -1: must be in [0, 1024]");
  CHECK(OptionError([](O& o) { o.model.restarts = -1; }) ==
        "model.restarts = -1: must be in [0, 100]");
  CHECK(OptionError([](O& o) { o.model.max_evaluations = 0; }) ==
        "model.max_evaluations = 0: must be in [1, 100000]");
  CHECK(
      Contains(OptionError([](O& o) { o.search.evaluations = 99; }), "search.evaluations = 99: "));
  CHECK(OptionError([](O& o) { o.rollout.sample_clamp = -1; }) ==
        "rollout.sample_clamp = -1: must be finite and >= 0");
  CHECK(OptionError([](O& o) { o.rollout.sample_clamp = std::nan(""); }) ==
        "rollout.sample_clamp = nan: must be finite and >= 0");
}

TEST_CASE("learner: a task or state that does not hold together is refused") {
  Task task = PointMassTask();
  task.action_limits = {0};
  CHECK(ErrorOf<InvalidInput>([&] { Learner(task, PointMassOptions()); }) ==
        "task point_mass: action_limits[0] = 0: must be finite and > 0");
  task = PointMassTask();
  task.start_std.pop_back();
  CHECK(ErrorOf<InvalidInput>([&] { Learner(task, PointMassOptions()); }) ==
        "task point_mass: start_std has 1 entries: must be 2");
  LearnerState state = PointMassState();
  state.transitions[7].action.clear();
  CHECK(ErrorOf<InvalidInput>([&] { Learner(PointMassTask(), PointMassOptions(), state); }) ==
        "transitions[7].action has 0 entries: must be 1");
}

}  // namespace
}  // namespace downpour
