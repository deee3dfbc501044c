// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "engine/learner/learner.h"
#include "engine/learner/learnt_policy.h"
#include "tools/c/downpour.h"
#include "tools/c/status.h"
#include "tools/downpour/config.h"
#include "tools/downpour/prior.h"

struct downpour_policy {
  downpour::LearntPolicy policy;
};

namespace downpour::c {
namespace {

Setting IntegerSetting(const char* origin, const char* key, std::int64_t value,
                       const std::string& text) {
  return {origin, key, value, text};
}

std::vector<Setting> ToSettings(const char* task, const downpour_learn_options& options) {
  RequireSet(task, "task");
  Threads(options.threads);  // checks
  std::vector<Setting> list = {
      {"task", "task", std::string(task), task},
      // A seed of 2^63 and more is refused as a negative number is, with its own digits.
      IntegerSetting("options.seed", "learn.seed", static_cast<std::int64_t>(options.seed),
                     std::to_string(options.seed)),
      IntegerSetting("options.episodes", "learn.episodes", options.episodes,
                     std::to_string(options.episodes)),
      IntegerSetting("options.threads", "learn.threads", options.threads,
                     std::to_string(options.threads))};
  RequireRange("options.n_settings", options.n_settings, 0, 1e6);
  if (options.n_settings > 0) RequireSet(options.settings, "options.settings");
  for (int i = 0; i < options.n_settings; ++i) {
    const std::string name = "options.settings[" + std::to_string(i) + "]";
    RequireSet(options.settings[i], name.c_str());
    list.push_back(ParseAssignment(name, options.settings[i]));
    RequireLibrarySetting(list.back());
  }
  return list;
}

void Tell(const EpisodeRecord& record, const downpour_learn_options& options) {
  if (options.episode_function == nullptr) return;
  const downpour_episode episode = {
      sizeof episode,        record.episode,          record.random ? 1 : 0,
      record.solved ? 1 : 0, record.points,           record.interaction_seconds,
      record.real_return,    record.predicted_return, record.evaluations,
      record.gp_queries,     record.model_seconds,    record.search_seconds};
  const int returned = options.episode_function(options.user_data, &episode);
  if (returned == 0) return;
  throw CallbackFailed("episode_function: returned " + std::to_string(returned) +
                       " after episode " + std::to_string(record.episode));
}

// Null if the last episode was random.
std::unique_ptr<downpour_policy> Learn(const char* task, const downpour_learn_options& options) {
  ResolvedRun run = ResolveConfig(ToSettings(task, options));
  UsePrior(run.config, &run.task);
  Learner learner(run.task, run.config.learner);
  while (!learner.done()) Tell(learner.RunEpisode({}), options);
  std::vector<double> parameters = learner.state().episodes.back().policy;
  if (parameters.empty()) return nullptr;
  std::shared_ptr<const Policy> policy = MakePolicy(run.task, run.config.learner.policy);
  return std::unique_ptr<downpour_policy>(new downpour_policy{
      LearntPolicy(std::move(run.task), std::move(policy), std::move(parameters))});
}

const LearntPolicy& Get(const downpour_policy* policy) {
  RequireSet(policy, "policy");
  return policy->policy;
}

}  // namespace
}  // namespace downpour::c

using namespace downpour;     // NOLINT: the functions are C's
using namespace downpour::c;  // NOLINT

int downpour_learn_options_init(downpour_learn_options* options) {
  return InitOptions(options, [](downpour_learn_options& to) {
    to.episodes = LearnerOptions().episodes;
    to.threads = 1;
  });
}

int downpour_learn(const char* task, const downpour_learn_options* options,
                   downpour_policy** policy) {
  return Guard([&] {
    RequireSet(policy, "policy");
    *policy = Learn(task, OptionsOr(downpour_learn_options_init, options)).release();
  });
}

void downpour_policy_destroy(downpour_policy* policy) { delete policy; }

int downpour_policy_sizes(const downpour_policy* policy, int* n_states, int* n_actions,
                          int* n_parameters) {
  return Guard([&] {
    const LearntPolicy& of = Get(policy);
    Set(of.task().n_states(), n_states);
    Set(of.task().n_actions(), n_actions);
    Set(of.policy().n_parameters(), n_parameters);
  });
}

int downpour_policy_parameters(const downpour_policy* policy, double* parameters) {
  return Guard([&] {
    const std::vector<double>& of = Get(policy).parameters();
    const std::span<double> room = Room(parameters, of.size(), "parameters");
    std::copy(of.begin(), of.end(), room.begin());
  });
}

int downpour_policy_act(const downpour_policy* policy, int step, const double* state,
                        double* action) {
  return Guard([&] {
    const LearntPolicy& of = Get(policy);
    RequireRange("step", step, 0, 1e9);
    const std::span<const double> observed = Numbers(state, of.task().n_states(), "state");
    RequireFinite(observed, "state");
    of.Act(step, observed, Room(action, of.task().n_actions(), "action"));
  });
}
