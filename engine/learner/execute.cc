// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/execute.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include "engine/errors.h"
#include "engine/learner/text_format.h"
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

}  // namespace

Execution ExecuteEpisode(const Task& task, System& system, int episode, StreamKey start_key,
                         StreamKey noise_key, const Controller& controller) {
  Execution execution;
  const std::size_t n_states = static_cast<std::size_t>(task.n_states());
  std::vector<double> states = AddNoise(task.start_mean, task.start_std, start_key, 0);
  states.resize(n_states * (task.horizon + 1));
  system.Reset(std::span(states).first(n_states));
  std::vector<double> features(task.features.size());
  std::vector<double> observation =
      AddNoise(std::span(states).first(n_states), task.observation_std, noise_key, 0);
  for (int step = 0; step < task.horizon; ++step) {
    Transition transition;
    transition.episode = episode;
    transition.step = step;
    transition.observation = observation;
    transition.action.resize(task.actions.size());
    ComputeFeatures(task, observation, features);
    controller(step, features, transition.action);
    CheckFinite(transition.action, task.actions, episode, step);
    for (std::size_t i = 0; i < task.actions.size(); ++i) {
      const double limit = task.action_limits[i];
      transition.action[i] = std::clamp(transition.action[i], -limit, limit);
    }
    const std::span<double> next = std::span(states).subspan((step + 1) * n_states, n_states);
    system.Step(transition.action, next);
    CheckFinite(next, task.states, episode, step);
    observation =
        AddNoise(next, task.observation_std, noise_key, static_cast<std::uint32_t>(step) + 1);
    transition.next_observation = observation;
    transition.next_state.assign(next.begin(), next.end());
    transition.reward = ComputeReward(task, next);
    execution.real_return += transition.reward;
    execution.transitions.push_back(std::move(transition));
  }
  execution.solved = task.solved(states);
  return execution;
}

}  // namespace downpour
