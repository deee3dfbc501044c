// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include "engine/learner/checkpoint.h"
#include "engine/learner/execute.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

constexpr StreamKey kStart = {1, 2};
constexpr StreamKey kNoise = {3, 4};

// A point mass that behaves as hardware does. The numbers are steps of one episode.
class MeasuredPointMass : public PointMass {
 public:
  bool measured() const override { return true; }
  std::optional<double> reward() const override { return own_reward; }
  bool done() const override { return step_ == done_at; }
  void Begin(int episode, std::span<const double> start, std::span<double> state) override {
    episode_begun = episode;
    asked.assign(start.begin(), start.end());
    step_ = 0;
    state[0] = 0.25;
    state[1] = -0.5;
    Reset(state);
  }
  void Step(std::span<const double> action, std::span<double> state) override {
    if (step_ == interrupt_at) throw Interrupted();
    if (step_ == fail_at) throw SystemFailure("the battery is empty");
    ++step_;
    PointMass::Step(action, state);
  }
  void End() noexcept override { ++n_ends; }

  int done_at = -1;
  int fail_at = -1;
  int interrupt_at = -1;
  std::optional<double> own_reward;
  int episode_begun = 0;
  std::vector<double> asked;
  int n_ends = 0;

 private:
  int step_ = 0;
};

void Push(int, std::span<const double>, std::span<double> action) { action[0] = 9; }

Execution Execute(MeasuredPointMass* system) {
  Task task = PointMassTask();
  task.solved = [](std::span<const double>) { return true; };
  return ExecuteEpisode(task, *system, 4, kStart, kNoise, Push);
}

TEST_CASE("measured system: observations are what it measured, from where it started") {
  const Task task = PointMassTask();
  MeasuredPointMass system;
  const Execution execution = Execute(&system);
  REQUIRE(execution.transitions.size() == 5);
  CHECK(system.episode_begun == 4);
  double z[2];
  FillNormals(kStart, 0, z, 2);
  CHECK(system.asked == std::vector<double>{0.1 * z[0], 0.2 * z[1]});
  std::vector<double> state = {0.25, -0.5};
  for (const Transition& t : execution.transitions) {
    CHECK(t.observation == state);
    CHECK(t.action[0] == 2);  // clipped
    state[1] += 0.1 * state[0];
    state[0] += 0.1 * 2;
    CHECK(t.next_observation == state);
    CHECK(t.next_state == state);
    const double miss = state[1] - 1;
    CHECK(t.reward == doctest::Approx(std::exp(-miss * miss / (2 * 0.5 * 0.5))).epsilon(1e-12));
  }
  CHECK(execution.outcome == "complete");
  CHECK(execution.solved);
  CHECK(system.n_ends == 1);
}

TEST_CASE("measured system: its own reward comes before the task's") {
  MeasuredPointMass system;
  system.own_reward = 0.75;
  CHECK(Execute(&system).real_return == 5 * 0.75);
}

TEST_CASE("measured system: an episode that it ends early is done and not solved") {
  MeasuredPointMass system;
  system.done_at = 3;
  const Execution execution = Execute(&system);
  CHECK(execution.transitions.size() == 3);
  CHECK(execution.outcome == "done");
  CHECK_FALSE(execution.solved);
  CHECK(system.n_ends == 1);
  system.done_at = 5;  // with the last step, that is no difference
  CHECK(Execute(&system).outcome == "complete");
}

TEST_CASE("measured system: a failure keeps the steps before it, without one it is thrown") {
  MeasuredPointMass system;
  system.fail_at = 2;
  const Execution execution = Execute(&system);
  CHECK(execution.transitions.size() == 2);
  CHECK(execution.outcome == "aborted at step 2: the battery is empty");
  CHECK_FALSE(execution.solved);
  CHECK(execution.real_return == execution.transitions[0].reward + execution.transitions[1].reward);
  system.fail_at = 0;
  CHECK(ErrorOf<SystemFailure>([&] { Execute(&system); }) == "the battery is empty");
  system.fail_at = -1;
  system.interrupt_at = 4;
  CHECK(Execute(&system).outcome == "aborted at step 4: interrupted");
  system.interrupt_at = 0;
  CHECK_THROWS_AS(Execute(&system), Interrupted);
  CHECK(system.n_ends == 4);
}

TEST_CASE("measured system: a policy that is not finite ends the episode and keeps its steps") {
  MeasuredPointMass system;
  const Execution execution =
      ExecuteEpisode(PointMassTask(), system, 4, kStart, kNoise,
                     [](int step, std::span<const double>, std::span<double> action) {
                       action[0] = step < 3 ? 1 : std::numeric_limits<double>::quiet_NaN();
                     });
  CHECK(execution.transitions.size() == 3);
  CHECK(execution.outcome ==
        "aborted at step 3: episode 4, step 3: force = nan on the real system: must be finite");
  CHECK(system.n_ends == 1);
}

// A run of `episodes` on point masses, the n-th of which fails at step fail_at[n] (-1: never).
LearnerState RunWithFailures(const std::vector<int>& fail_at, const LearnerOptions& options,
                             LearnerState state = {}) {
  class Failing : public MeasuredPointMass {
   public:
    explicit Failing(std::vector<int> all) : all_(std::move(all)) {}
    void Begin(int episode, std::span<const double> start, std::span<double> state) override {
      fail_at = all_.at(static_cast<std::size_t>(episode) - 1);
      MeasuredPointMass::Begin(episode, start, state);
    }

   private:
    std::vector<int> all_;
  };
  Task task = PointMassTask();
  task.make_system = [fail_at] { return std::make_unique<Failing>(fail_at); };
  Learner learner(task, options, std::move(state));
  while (!learner.done()) learner.RunEpisode({});
  return learner.state();
}

TEST_CASE("measured system: the model learns from episodes that were cut short, down to one step") {
  LearnerOptions options;
  options.episodes = 4;
  options.policy.hidden_units = {2};
  options.search.evaluations = 600;
  options.search.final_rollouts = 10;
  options.model.max_evaluations = 20;
  options.threads = 1;
  const LearnerState state = RunWithFailures({1, 3, -1, 2}, options);
  const std::vector<int> steps = {1, 3, 5, 2}, points = {0, 1, 4, 9};
  for (std::size_t i = 0; i < 4; ++i) {
    const EpisodeRecord& record = state.episodes[i];
    CHECK(record.steps == steps[i]);
    CHECK(record.points == points[i]);
    CHECK(Aborted(record) == (steps[i] < 5));
    CHECK(record.interaction_seconds == doctest::Approx(0.1 * (points[i] + steps[i])));
  }
  CHECK(state.transitions.size() == 11);
  // A checkpoint holds it, and a run goes on from it with the same bits.
  const std::string text = FormatCheckpoint(PointMassTask(), options, state);
  CHECK(SameBits(ParseCheckpoint(PointMassTask(), options, text, "c"), state));
  LearnerOptions shorter = options;
  shorter.episodes = 2;
  const LearnerState half = RunWithFailures({1, 3}, shorter);
  CHECK(SameBits(RunWithFailures({1, 3, -1, 2}, options, half), state));
}

TEST_CASE("measured system: a failure before the first step leaves the state as it was") {
  LearnerOptions options;
  Task task = PointMassTask();
  task.make_system = [] {
    auto system = std::make_unique<MeasuredPointMass>();
    system->fail_at = 0;
    return system;
  };
  Learner learner(task, options);
  CHECK_THROWS_AS(learner.RunEpisode({}), SystemFailure);
  CHECK(learner.state().episodes.empty());
  CHECK(learner.state().transitions.empty());
}

}  // namespace
}  // namespace downpour
