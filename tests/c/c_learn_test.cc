// SPDX-License-Identifier: Apache-2.0
#include <limits>
#include <vector>

#include "engine/learner/learner.h"
#include "engine/learner/learnt_policy.h"
#include "tasks/registry.h"
#include "tests/c/c_fixture.h"

namespace downpour {
namespace {

using CPolicy = std::unique_ptr<downpour_policy, decltype(&downpour_policy_destroy)>;

const char* const kSettings[] = {"search.evaluations=600", "search.final_rollouts = 24",
                                 "model.max_evaluations=30", "policy.hidden_units=4,3"};

// A run of a second.
downpour_learn_options Tiny() {
  downpour_learn_options options;
  downpour_learn_options_init(&options);
  options.episodes = 3;
  options.seed = 7;
  options.settings = kSettings;
  options.n_settings = 4;
  return options;
}

LearnerOptions TinyOptions() {
  LearnerOptions options;
  options.episodes = 3;
  options.seed = 7;
  options.search.evaluations = 600;
  options.search.final_rollouts = 24;
  options.model.max_evaluations = 30;
  options.policy.hidden_units = {4, 3};
  return options;
}

// What the callback was told; fails after episode `fail_at`.
struct Told {
  std::vector<downpour_episode> episodes;
  int fail_at = 0;
};

int Tell(void* user_data, const downpour_episode* episode) {
  auto* const told = static_cast<Told*>(user_data);
  told->episodes.push_back(*episode);
  return episode->episode == told->fail_at ? -3 : 0;
}

CPolicy Learn(const char* task, const downpour_learn_options& options) {
  downpour_policy* policy = nullptr;
  const int status = downpour_learn(task, &options, &policy);
  REQUIRE_MESSAGE(status == DOWNPOUR_OK, downpour_last_error());
  return {policy, &downpour_policy_destroy};
}

void CheckEpisode(const downpour_episode& told, const EpisodeRecord& record) {
  CHECK(told.size == sizeof told);
  CHECK(told.episode == record.episode);
  CHECK(told.random == (record.random ? 1 : 0));
  CHECK(told.solved == (record.solved ? 1 : 0));
  CHECK(told.points == record.points);
  CHECK(told.interaction_seconds == record.interaction_seconds);
  CHECK(told.real_return == record.real_return);
  CHECK((record.random ? std::isnan(told.predicted_return)
                       : told.predicted_return == record.predicted_return));
  CHECK(told.evaluations == record.evaluations);
  CHECK(told.gp_queries == record.gp_queries);
}

TEST_CASE("C learn: episodes, parameters and actions are the bits of Learner, for any threads") {
  // dmp's actions depend on the step, too.
  for (const auto& [kind, setting] : {std::pair(PolicyKind::kNeuralNetwork, "policy.kind=nn"),
                                      {PolicyKind::kDmp, "policy.kind=dmp"}}) {
    LearnerOptions wanted = TinyOptions();
    wanted.policy.kind = kind;
    Learner learner(MakeTask("pendulum"), wanted);
    while (!learner.done()) learner.RunEpisode({});
    std::vector<const char*> settings(kSettings, kSettings + 4);
    settings.push_back(setting);
    downpour_learn_options options = Tiny();
    options.settings = settings.data();
    options.n_settings = 5;
    options.threads = kind == PolicyKind::kDmp ? 2 : 1;
    const std::vector<EpisodeRecord>& records = learner.state().episodes;
    Told told;
    options.episode_function = Tell;
    options.user_data = &told;
    const CPolicy policy = Learn("pendulum", options);
    REQUIRE(told.episodes.size() == 3);
    for (int i = 0; i < 3; ++i) CheckEpisode(told.episodes[i], records[i]);

    int n_states = 0, n_actions = 0, n_parameters = 0;
    REQUIRE(downpour_policy_sizes(policy.get(), &n_states, &n_actions, &n_parameters) == 0);
    CHECK(downpour_policy_sizes(policy.get(), nullptr, nullptr, nullptr) == DOWNPOUR_OK);
    CHECK(n_states == 2);
    CHECK(n_actions == 1);
    std::vector<double> parameters(n_parameters);
    REQUIRE(downpour_policy_parameters(policy.get(), parameters.data()) == DOWNPOUR_OK);
    CHECK(parameters == records.back().policy);
    for (const Transition& t : learner.state().transitions) {
      if (t.episode != 3) continue;
      double action = 0;
      REQUIRE(downpour_policy_act(policy.get(), t.step, t.observation.data(), &action) == 0);
      CHECK(action == t.action[0]);
    }
  }
}

TEST_CASE("C learn: what is wrong is told, and the policy stays") {
  const downpour_learn_options tiny = Tiny();
  downpour_policy* policy = nullptr;
  const auto fails = [&](const char* task, const downpour_learn_options& options,
                         const char* text) {
    CheckFailure(downpour_learn(task, &options, &policy), DOWNPOUR_INVALID_INPUT, text);
    CHECK(policy == nullptr);
  };
  fails(nullptr, tiny, "task: NULL");
  fails("cart", tiny, "cart");
  fails("nowhere.toml", tiny, "nowhere.toml: cannot read");
  CheckFailure(downpour_learn("pendulum", &tiny, nullptr), DOWNPOUR_INVALID_INPUT, "policy: NULL");
  downpour_learn_options options = tiny;
  options.size = 3;
  fails("pendulum", options, "options: size = 3");
  options = tiny;
  options.episodes = 1;
  fails("pendulum", options,
        "options.episodes: learn.episodes = 1: must be an integer in [2, 1000]");
  options = tiny;
  options.threads = -1;
  fails("pendulum", options, "threads = -1");
  options = tiny;
  options.seed = std::numeric_limits<std::uint64_t>::max();
  fails("pendulum", options, "options.seed: learn.seed = 18446744073709551615: must be");
  options = tiny;
  options.n_settings = -1;
  fails("pendulum", options, "options.n_settings = -1");
  const std::pair<const char*, const char*> wrong[] = {
      {"search.evaluations", "options.settings[0] search.evaluations: must be KEY=VALUE"},
      {"search.evals=5", "options.settings[0]: unknown key search.evals"},
      {"search.evaluations=-5", "options.settings[0]: search.evaluations = -5: must be"},
      {"output.json=true", "options.settings[0]: output.json is the command's alone"},
      {nullptr, "options.settings[0]: NULL"}};
  for (const auto& row : wrong) {
    options = tiny;
    options.settings = &row.first;
    options.n_settings = 1;
    fails("pendulum", options, row.second);
  }
  options.settings = nullptr;
  fails("pendulum", options, "options.settings: NULL");
  CheckFailure(downpour_learn_options_init(nullptr), DOWNPOUR_INVALID_INPUT, "options: NULL");
}

TEST_CASE("C learn: a callback ends the learning with its number") {
  Told told;
  told.fail_at = 2;
  downpour_learn_options options = Tiny();
  options.episode_function = Tell;
  options.user_data = &told;
  downpour_policy* policy = nullptr;
  CheckFailure(downpour_learn("pendulum", &options, &policy), DOWNPOUR_CALLBACK_FAILED,
               "episode_function: returned -3 after episode 2");
  CHECK(policy == nullptr);
  CHECK(told.episodes.size() == 2);
}

TEST_CASE("C policy: arguments are checked") {
  downpour_learn_options options = Tiny();
  options.episodes = 2;
  const CPolicy policy = Learn("pendulum", options);
  double state[2] = {0, 0}, action = 0;
  CheckFailure(downpour_policy_act(nullptr, 0, state, &action), DOWNPOUR_INVALID_INPUT,
               "policy: NULL");
  CheckFailure(downpour_policy_act(policy.get(), -1, state, &action), DOWNPOUR_INVALID_INPUT,
               "step = -1");
  CheckFailure(downpour_policy_act(policy.get(), 0, nullptr, &action), DOWNPOUR_INVALID_INPUT,
               "state: NULL");
  CheckFailure(downpour_policy_act(policy.get(), 0, state, nullptr), DOWNPOUR_INVALID_INPUT,
               "action: NULL");
  CheckFailure(downpour_policy_parameters(policy.get(), nullptr), DOWNPOUR_INVALID_INPUT,
               "parameters: NULL");
  state[1] = std::numeric_limits<double>::quiet_NaN();
  CheckFailure(downpour_policy_act(policy.get(), 0, state, &action), DOWNPOUR_INVALID_INPUT,
               "state[1]");
  downpour_policy_destroy(nullptr);
}

}  // namespace
}  // namespace downpour
