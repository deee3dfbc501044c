// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/execute.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>

#include "engine/errors.h"
#include "engine/learner/text_format.h"
#include "engine/rollout/reward.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// mean + std z with the stream's numbers at `counter`.
std::vector<double> AddNoise(std::span<const double> mean, const std::vector<double>& std,
                             StreamKey key, std::uint32_t counter) {
  std::vector<double> sample(mean.size());
  FillNormals(key, counter, sample.data(), sample.size());
  for (std::size_t i = 0; i < mean.size(); ++i) sample[i] = mean[i] + std[i] * sample[i];
  return sample;
}

void CheckFinite(std::span<const double> values, const std::vector<Variable>& variables,
                 int episode, int step) {
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (std::isfinite(values[i])) continue;
    throw InvalidInput("episode " + std::to_string(episode) + ", step " + std::to_string(step) +
                       ": " + variables[i].name + " = " + FormatNumber(values[i]) +
                       " on the real system: must be finite");
  }
}

// What rollouts take as divergence is no reward on the real system either.
void CheckReward(double reward, int episode, int step) {
  if (std::abs(reward) <= Reward::kLimit) return;
  throw InvalidInput("episode " + std::to_string(episode) + ", step " + std::to_string(step) +
                     ": reward = " + FormatNumber(reward) +
                     " on the real system: must be within +-" + FormatNumber(Reward::kLimit));
}

// What the steps of an episode work on.
struct Episode {
  const Task& task;
  System& system;
  int episode;
  StreamKey noise_key;
  const Controller& controller;
  std::vector<double> noise_std;  // (E) of what is added to the system's states
  std::vector<double> states;     // (H + 1 x E) of the system
  std::vector<double> observation;
};

// Step `step` from the episode's observation, which it replaces.
Transition RunStep(int step, Episode* e) {
  const Task& task = e->task;
  const std::size_t n_states = task.states.size();
  Transition transition;
  transition.episode = e->episode;
  transition.step = step;
  transition.observation = e->observation;
  transition.action.resize(task.actions.size());
  std::vector<double> features(task.features.size());
  ComputeFeatures(task, e->observation, features);
  e->controller(step, features, transition.action);
  CheckFinite(transition.action, task.actions, e->episode, step);
  for (std::size_t i = 0; i < task.actions.size(); ++i) {
    const double limit = task.action_limits[i];
    transition.action[i] = std::clamp(transition.action[i], -limit, limit);
  }
  const std::span<double> next = std::span(e->states).subspan((step + 1) * n_states, n_states);
  e->system.Step(transition.action, next);
  CheckFinite(next, task.states, e->episode, step);
  e->observation = AddNoise(next, e->noise_std, e->noise_key, static_cast<std::uint32_t>(step) + 1);
  transition.next_observation = e->observation;
  transition.next_state.assign(next.begin(), next.end());
  transition.reward =
      e->system.reward().value_or(ComputeReward(task, step, next, transition.action));
  CheckReward(transition.reward, e->episode, step);
  return transition;
}

}  // namespace

Execution ExecuteEpisode(const Task& task, System& system, int episode, StreamKey start_key,
                         StreamKey noise_key, const Controller& controller) {
  const std::size_t n_states = task.states.size();
  Episode e{task, system, episode, noise_key, controller, task.observation_std, {}, {}};
  if (system.measured()) e.noise_std.assign(n_states, 0.0);
  e.states.resize(n_states * (task.horizon + 1));
  const std::span<double> first = std::span(e.states).first(n_states);
  system.Begin(episode, AddNoise(task.start_mean, task.start_std, start_key, 0), first);
  e.observation = AddNoise(first, e.noise_std, noise_key, 0);
  Execution execution;
  try {
    for (int step = 0; step < task.horizon && !(step > 0 && system.done()); ++step) {
      execution.transitions.push_back(RunStep(step, &e));
      execution.real_return += execution.transitions.back().reward;
    }
  } catch (const std::runtime_error& error) {
    system.End();
    const std::size_t n_steps = execution.transitions.size();
    if (!system.measured() || n_steps == 0) throw;
    execution.outcome =
        std::string(kAborted) + " at step " + std::to_string(n_steps) + ": " + error.what();
    return execution;
  }
  system.End();
  const bool whole = execution.transitions.size() == static_cast<std::size_t>(task.horizon);
  if (!whole) execution.outcome = kDone;
  execution.solved = whole && task.solved(e.states);
  return execution;
}

}  // namespace downpour
