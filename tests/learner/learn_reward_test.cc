// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <filesystem>
#include <memory>

#include "engine/learner/checkpoint.h"
#include "engine/learner/csv_tables.h"
#include "tasks/registry.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

// A short run, the reward unknown.
LearnerOptions UnknownReward() {
  LearnerOptions options = TinyOptions();
  options.learn_reward = true;
  return options;
}

TEST_CASE("learn_reward: the reward is one more output of the model, on the state's features") {
  const Task task = PointMassTask();
  const LearnerState state = Run(task, UnknownReward());
  for (int i = 1; i < 4; ++i) {
    const EpisodeRecord& record = state.episodes[i];
    REQUIRE(record.hyperparameters.size() == 3);
    CHECK(record.hyperparameters[0].lengthscales.size() == 3);
    CHECK(record.hyperparameters[2].lengthscales.size() == 2);
    CHECK(record.jitter.size() == 3);
    CHECK(record.plans.size() == 3);
    CHECK(record.query_nanoseconds.size() == 3);
    CHECK(record.gp_queries == record.evaluations * 5 * 3);
  }
}

TEST_CASE("learn_reward: rollouts never ask the task for its reward") {
  class Counted final : public Reward {
   public:
    explicit Counted(int* calls) : calls_(calls) {}
    std::string Describe() const override { return "counted"; }
    bool InUnitInterval() const override { return true; }
    void EvaluateTile(int, const double*, const double*, const double*,
                      double* rewards) const override {
      ++*calls_;
      std::fill_n(rewards, kTileLanes, 0.5);
    }

   private:
    int* calls_;
  };
  Task task = PointMassTask();
  int calls = 0;
  task.reward = std::make_shared<Counted>(&calls);
  LearnerOptions options = UnknownReward();
  options.threads = 1;
  Run(task, options);
  CHECK(calls == 4 * 5);  // one a step on the real system
}

TEST_CASE("learn_reward: it is learnt from what was observed: rewards and next observations") {
  const Task task = PointMassTask();
  LearnerOptions options = UnknownReward();
  options.episodes = 2;
  const LearnerState state = Run(task, options, {}, 1);
  const EpisodeRecord record = Run(task, options, state).episodes[1];
  LearnerState other = state;
  other.transitions[2].next_state[0] += 1;
  CHECK(SameBits(Run(task, options, other).episodes[1], record));
  other = state;
  other.transitions[2].reward += 0.1;
  const EpisodeRecord with_other_reward = Run(task, options, other).episodes[1];
  CHECK_FALSE(SameBits(with_other_reward.policy, record.policy));
  for (int e = 0; e < 2; ++e) {
    CHECK(SameBits(with_other_reward.hyperparameters[e].lengthscales,
                   record.hyperparameters[e].lengthscales));
  }
  // The last observation is no input of the dynamics.
  other = state;
  other.transitions[4].next_observation[1] += 0.1;
  CHECK_FALSE(SameBits(Run(task, options, other).episodes[1].hyperparameters[2].lengthscales,
                       record.hyperparameters[2].lengthscales));
}

TEST_CASE("learn_reward: its hyper-parameters start from its own of the last episode") {
  const Task task = PointMassTask();
  LearnerOptions options = UnknownReward();
  options.model.max_evaluations = 1;
  options.model.restarts = 0;
  const LearnerState state = Run(task, options, {}, 2);
  const auto noise_std = [&](const LearnerState& s) {
    return Run(task, options, s, 3).episodes[2].hyperparameters[2].noise_std;
  };
  LearnerState other = state;
  other.episodes[1].hyperparameters[0].noise_std *= 2;
  CHECK(SameBits(noise_std(other), noise_std(state)));
  other.episodes[1].hyperparameters[2].noise_std *= 2;
  CHECK_FALSE(SameBits(noise_std(other), noise_std(state)));
}

TEST_CASE("learn_reward: a run stopped and resumed ends with the same bits, on any threads") {
  const TemporaryDirectory directory;
  const std::filesystem::path file = directory.path() / "checkpoint.json";
  for (const char* name : {"arm", "pendulum"}) {
    const Task task = MakeTask(name);
    LearnerOptions options = UnknownReward();
    const LearnerState whole = Run(task, options);
    WriteCheckpoint(file, task, options, Run(task, options, {}, 2));
    CHECK(SameBits(Run(task, options, ReadCheckpoint(file, task, options)), whole));
    options.threads = 5;
    CHECK(SameBits(Run(task, options), whole));
  }
}

TEST_CASE("learn_reward: tables name the output reward and its own inputs") {
  const Task task = PointMassTask();
  LearnerOptions options = UnknownReward();
  options.episodes = 2;
  const LearnerState state = Run(task, options);
  const std::vector<Variable> outputs = ModelOutputs(task, options);
  CHECK(Contains(TimingCsv(outputs, state), ",gp_query_time.reward [ns]\n1,"));
  CHECK(Contains(PlansCsv(outputs, state), "\n2,reward,fused,5,"));
  const std::string table = HyperparametersCsv(task, outputs, state);
  CHECK(Contains(table, "\n2,reward,lengthscale.velocity,m/s,"));
  CHECK(Contains(table, "\n2,reward,signal_std,1,"));
  CHECK_FALSE(Contains(table, "\n2,reward,lengthscale.force,"));
  CHECK(Contains(table, "\n2,velocity,lengthscale.force,N,"));
}

TEST_CASE("learn_reward: a state without the reward's numbers is refused") {
  const Task task = PointMassTask();
  LearnerOptions options = UnknownReward();
  options.episodes = 2;
  LearnerState state = Run(task, options);
  options.episodes = 3;
  state.episodes[1].hyperparameters[2].lengthscales.push_back(1);
  CHECK(ErrorOf<InvalidInput>([&] { Learner(task, options, state); }) ==
        "episodes[1].hyperparameters[2].lengthscales has 3 entries: must be 2");
  state.episodes[1].hyperparameters.pop_back();
  CHECK(ErrorOf<InvalidInput>([&] { Learner(task, options, state); }) ==
        "episodes[1].hyperparameters has 2 entries: must be 3");
}

TEST_CASE("learn_reward: lost causes cannot be told by a reward that may leave [0, 1]") {
  LearnerOptions options = UnknownReward();
  options.search.stop_lost_causes = true;
  CHECK(ErrorOf<InvalidInput>([&] { Learner(PointMassTask(), options); }) ==
        "search.stop_lost_causes = true: must be false where rewards may leave [0, 1], as learnt "
        "ones (learn.learn_reward) may");
  options.learn_reward = false;
  CHECK(ErrorOf<InvalidInput>([&] { Learner(PointMassTask(), options); }) == "");
}

}  // namespace
}  // namespace downpour
