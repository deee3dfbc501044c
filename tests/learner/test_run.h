// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "engine/learner/learner.h"
#include "engine/rollout/reward.h"
#include "tests/temporary_directory.h"

namespace downpour {

// A point mass on a line, pushed by a force; Euler steps. State (velocity, position).
class PointMass : public System {
 public:
  void Reset(std::span<const double> state) override { state_ = {state[0], state[1]}; }
  void Step(std::span<const double> action, std::span<double> state) override {
    state_[1] += 0.1 * state_[0];
    state_[0] += 0.1 * action[0];
    std::copy(state_.begin(), state_.end(), state.begin());
  }

 private:
  std::array<double, 2> state_ = {};
};

// "Bring the mass to position 1"; the names need quotes in CSV and escapes in JSON.
inline Task PointMassTask() {
  Task task;
  task.name = "point_mass";
  task.preset = "paper";
  task.states = {{"velocity", "m/s"}, {"position, \"x\"", "m"}};
  task.features = {{FeatureKind::kIdentity, 0}, {FeatureKind::kIdentity, 1}};
  task.feature_names = task.states;
  task.actions = {{"force", "N"}};
  task.action_limits = {2};
  task.start_mean = {0, 0};
  task.start_std = {0.1, 0.2};
  task.observation_std = {0.01, 0.02};
  task.policy_input_scale = {1, 1};
  task.horizon = 5;
  task.reward = MakeSaturatingReward(task.feature_names, {0, 1}, {1}, 0.5);
  task.solved = [](std::span<const double> states) { return states[states.size() - 1] > 0.9; };
  task.model_digest = "one";
  task.make_system = [] { return std::make_unique<PointMass>(); };
  return task;
}

inline bool SameBits(double a, double b) { return std::memcmp(&a, &b, sizeof(double)) == 0; }

inline bool SameBits(const std::vector<double>& a, const std::vector<double>& b) {
  return a.size() == b.size() &&
         (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(double)) == 0);
}

inline bool SameBits(const EpisodeRecord& a, const EpisodeRecord& b) {
  bool same =
      a.episode == b.episode && a.random == b.random &&
      SameBits(a.interaction_seconds, b.interaction_seconds) && a.points == b.points &&
      a.evaluations == b.evaluations && a.gp_queries == b.gp_queries && a.diverged == b.diverged &&
      SameBits(a.jitter, b.jitter) && a.platform.simd_target == b.platform.simd_target &&
      a.platform.blas_core == b.platform.blas_core &&
      SameBits(a.predicted_return, b.predicted_return) && SameBits(a.real_return, b.real_return) &&
      a.solved == b.solved && a.steps == b.steps && a.outcome == b.outcome && a.plans == b.plans &&
      a.plan_changes == b.plan_changes && SameBits(a.policy, b.policy) &&
      a.runs.size() == b.runs.size() && a.hyperparameters.size() == b.hyperparameters.size();
  for (std::size_t i = 0; same && i < a.hyperparameters.size(); ++i) {
    const Hyperparameters &x = a.hyperparameters[i], &y = b.hyperparameters[i];
    same = SameBits(x.lengthscales, y.lengthscales) && SameBits(x.signal_std, y.signal_std) &&
           SameBits(x.noise_std, y.noise_std);
  }
  for (std::size_t i = 0; same && i < a.runs.size(); ++i) {
    const RunRecord &x = a.runs[i], &y = b.runs[i];
    same = x.run == y.run && x.large == y.large && x.population == y.population &&
           SameBits(x.initial_sigma, y.initial_sigma) && x.evaluations == y.evaluations &&
           x.stop == y.stop && SameBits(x.mean_return, y.mean_return);
  }
  return same;
}

// Everything but the wall-clock times.
inline bool SameBits(const LearnerState& a, const LearnerState& b) {
  bool same =
      a.episodes.size() == b.episodes.size() && a.transitions.size() == b.transitions.size();
  for (std::size_t i = 0; same && i < a.episodes.size(); ++i) {
    same = SameBits(a.episodes[i], b.episodes[i]);
  }
  for (std::size_t i = 0; same && i < a.transitions.size(); ++i) {
    const Transition &x = a.transitions[i], &y = b.transitions[i];
    same = x.episode == y.episode && x.step == y.step && SameBits(x.observation, y.observation) &&
           SameBits(x.action, y.action) && SameBits(x.next_observation, y.next_observation) &&
           SameBits(x.next_state, y.next_state) && SameBits(x.reward, y.reward);
  }
  return same;
}

// A state as two episodes of PointMassTask with one hidden unit leave it (P = 2 + 1 + 1 + 1), the
// second one cut short, with the numbers that text formats lose.
inline LearnerState PointMassState() {
  const double denormal = std::numeric_limits<double>::denorm_min();
  LearnerState state;
  for (int episode = 1; episode <= 2; ++episode) {
    for (int step = 0; step < (episode == 1 ? 5 : 3); ++step) {
      state.transitions.push_back({.episode = episode,
                                   .step = step,
                                   .observation = {denormal, -0.0},
                                   .action = {1.0 / 3},
                                   .next_observation = {std::nextafter(1.0, 2.0), 1e308},
                                   .next_state = {0.1 * step, -1e-300},
                                   .reward = 0.1});
    }
  }
  EpisodeRecord random;
  random.episode = 1;
  random.random = true;
  random.interaction_seconds = 0.5;
  random.predicted_return = random.lane_fill = random.idle_share =
      std::numeric_limits<double>::quiet_NaN();
  random.steps = 5;
  random.platform = {"AVX3", "SkylakeX"};
  EpisodeRecord learnt;
  learnt.episode = 2;
  learnt.interaction_seconds = 1;
  learnt.points = 5;
  learnt.model_seconds = 0.25;
  learnt.search_seconds = 0.5;
  learnt.rollout_seconds = 0.375;
  learnt.evaluations = std::int64_t{1} << 53;
  learnt.gp_queries = std::numeric_limits<std::int64_t>::max();
  learnt.diverged = 3;
  learnt.lane_fill = 2.0 / 3;
  learnt.idle_share = 1.0 / 3;
  learnt.predicted_return = 4.0 / 3;
  learnt.real_return = denormal;
  learnt.solved = true;
  learnt.steps = 3;
  learnt.outcome = std::string(kAborted) + " at step 3: \"x\", y";
  learnt.policy = {0.1, 0.2, 0.3, -0.0, denormal};
  learnt.hyperparameters = {{{0.1, 0.2, 0.7}, 1.1, 1e-5}, {{1e-300, 1e300, 3}, 2.2, 0.3}};
  learnt.jitter = {0, 1e-10};
  learnt.plans = {{QueryBackend::kBlas, 5, false, 0, 1, 0, 0},
                  {QueryBackend::kFused, 3, true, 0.003, 1.0 / 3, 0.01, 4.9e-324}};
  learnt.plan_changes = 2;
  learnt.query_nanoseconds = {1.0 / 3, 0.1};
  learnt.platform = {"AVX2", "Haswell"};
  learnt.runs.resize(2);
  learnt.runs[0].population = 8;
  learnt.runs[0].initial_sigma = 0.1;
  learnt.runs[0].stop = "Tol\"X\"\n";
  learnt.runs[1].run = 1;
  learnt.runs[1].large = true;
  learnt.runs[1].mean_return = -std::numeric_limits<double>::infinity();
  state.episodes = {random, learnt};
  return state;
}

inline LearnerOptions PointMassOptions() {
  LearnerOptions options;
  options.policy.hidden_units = {1};
  options.search.evaluations = 5000;
  options.search.restarts = RestartStrategy::kBipop;
  options.seed = std::numeric_limits<std::uint64_t>::max();
  return options;
}

// A budget that runs in well under a second an episode; it need not learn anything.
inline LearnerOptions TinyOptions() {
  LearnerOptions options;
  options.episodes = 4;
  options.seed = 5;
  options.threads = 2;
  options.model.max_evaluations = 30;
  options.search.evaluations = 600;
  options.search.final_rollouts = 24;
  return options;
}

// The state after `episodes` of them, or after as many as the options say.
inline LearnerState Run(const Task& task, const LearnerOptions& options, LearnerState state = {},
                        std::size_t episodes = 1000) {
  Learner learner(task, options, std::move(state));
  while (!learner.done() && learner.state().episodes.size() < episodes) learner.RunEpisode({});
  return learner.state();
}

// what() of the exception E that `action` throws; "" if none.
template <typename E>
std::string ErrorOf(const std::function<void()>& action) {
  try {
    action();
  } catch (const E& error) {
    return error.what();
  }
  return "";
}

inline bool Contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

}  // namespace downpour
