// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/replay.h"

#include <fmt/format.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "engine/errors.h"

namespace downpour {
namespace {

// Room for the last bits of another machine's mathematical library.
constexpr double kTolerance = 1e-6;

void CheckRepeats(const Task& task, const Transition& recorded, std::span<const double> state) {
  for (std::size_t e = 0; e < state.size(); ++e) {
    const double was = recorded.next_state[e];
    if (std::abs(state[e] - was) <= kTolerance * (1 + std::abs(was))) continue;
    throw InvalidInput(
        fmt::format("episode {}, step {}: {} comes out as {:.6g}, recorded is {:.6g}: the model or "
                    "MuJoCo must be that of the run",
                    recorded.episode, recorded.step, task.states[e].name, state[e], was));
  }
}

}  // namespace

std::vector<std::vector<double>> Replay(const Task& task, MujocoSystem* system,
                                        std::span<const double> start,
                                        std::span<const Transition> transitions,
                                        std::span<const double> times) {
  const mjData& data = system->data();
  const double slack = 0.5 * system->model().opt.timestep;
  std::vector<std::vector<double>> poses;
  const auto take = [&] {
    while (poses.size() < times.size() && data.time >= times[poses.size()] - slack) {
      poses.emplace_back(data.qpos, data.qpos + system->model().nq);
    }
  };
  system->Reset(start);
  take();
  std::vector<double> state(task.n_states());
  for (const Transition& transition : transitions) {
    system->StepObserved(transition.action, state, take);
    CheckRepeats(task, transition, state);
  }
  return poses;
}

std::vector<double> Interpolate(std::span<const double> states, int n_states, double position) {
  const int last = static_cast<int>(states.size()) / n_states - 1;
  const int step = std::clamp(static_cast<int>(position), 0, std::max(0, last - 1));
  const double t = position - step;
  std::vector<double> state(n_states);
  for (int e = 0; e < n_states; ++e) {
    const auto at = [&](int i) { return states[std::clamp(i, 0, last) * n_states + e]; };
    const double slope0 = (at(step + 1) - at(step - 1)) / 2;
    const double slope1 = (at(step + 2) - at(step)) / 2;
    const double rise = at(step + 1) - at(step);
    state[e] =
        at(step) +
        t * (slope0 + t * (3 * rise - 2 * slope0 - slope1 + t * (slope0 + slope1 - 2 * rise)));
  }
  return state;
}

}  // namespace downpour
