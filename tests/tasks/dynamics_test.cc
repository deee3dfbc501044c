// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "kernels/philox/philox.h"
#include "tasks/registry.h"
#include "tests/tasks/ode_reference.h"

namespace downpour {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kGravity = 9.82;
constexpr int kSamples = 1000;

// [angular velocity, angle]; a uniform rod of 1 kg and 1 m, friction 0.01 N m s/rad.
struct PendulumOde {
  long double torque;
  std::array<long double, 2> operator()(const std::array<long double, 2>& y) const {
    const long double m = 1, l = 1, g = 9.82L, b = 0.01L;
    return {(torque - b * y[0] - m * g * l * std::sin(y[1]) / 2) / (m * l * l / 3), y[0]};
  }
};

// [cart velocity, position, pole velocity, angle]; 0.5 kg each, 0.5 m, friction 0.1 N s/m.
struct CartpoleOde {
  long double force;
  std::array<long double, 4> operator()(const std::array<long double, 4>& y) const {
    const long double m = 0.5L, M = 0.5L, l = 0.5L, g = 9.82L, b = 0.1L;
    const long double s = std::sin(y[3]), c = std::cos(y[3]), w = y[2];
    const long double cart =
        (2 * m * l * w * w * s + 3 * m * g * s * c + 4 * force - 4 * b * y[0]) /
        (4 * (M + m) - 3 * m * c * c);
    const long double pole =
        (-3 * m * l * w * w * s * c - 6 * (M + m) * g * s - 6 * (force - b * y[0]) * c) /
        (4 * l * (m + M) - 3 * m * l * c * c);
    return {cart, y[0], pole, w};
  }
};

// One control period of MuJoCo and of the ODE from kSamples random states and actions, the state
// uniform in +-range: the largest difference of each state variable.
template <typename Ode, std::size_t N>
std::array<double, N> LargestDifference(const Task& task, const std::array<double, N>& range,
                                        long double* worst_reference_error) {
  std::vector<double> uniforms(kSamples * (N + 1));
  FillUniforms(StreamKey{2023, N}, 0, uniforms.data(), uniforms.size());
  const std::unique_ptr<System> system = task.make_system();
  std::array<double, N> largest{};
  *worst_reference_error = 0;
  for (int sample = 0; sample < kSamples; ++sample) {
    const double* u = &uniforms[sample * (N + 1)];
    std::array<double, N> state, next;
    std::array<long double, N> start;
    for (std::size_t i = 0; i < N; ++i) start[i] = state[i] = range[i] * (2 * u[i] - 1);
    const double action = task.action_limits[0] * (2 * u[N] - 1);
    system->Reset(state);
    system->Step({&action, 1}, next);
    long double error;
    const std::array<long double, N> expected = SolveOde(Ode{action}, start, 0.1L, 20, &error);
    *worst_reference_error = std::fmax(*worst_reference_error, error);
    for (std::size_t i = 0; i < N; ++i) {
      const double difference = static_cast<double>(std::fabs(next[i] - expected[i]));
      largest[i] = difference <= largest[i] ? largest[i] : difference;  // NaN is kept
    }
  }
  return largest;
}

TEST_CASE("ode_reference: matches closed forms to 1e-15") {
  long double error;
  const auto oscillator = [](const std::array<long double, 2>& y) {
    return std::array<long double, 2>{-100 * y[1], y[0]};
  };
  const auto y = SolveOde(oscillator, std::array<long double, 2>{0, 1}, 0.7L, 100, &error);
  CHECK(std::fabs(y[1] - std::cos(7.0L)) < 1e-15L);
  CHECK(std::fabs(y[0] + 10 * std::sin(7.0L)) < 1e-14L);
  CHECK(error < 1e-14L);
}

TEST_CASE("pendulum: one MuJoCo step is the ODE to 1e-6 for 1,000 random states and actions") {
  long double error;
  const auto largest =
      LargestDifference<PendulumOde, 2>(MakeTask("pendulum"), {15, 2 * kPi}, &error);
  MESSAGE("largest difference: angular velocity ", largest[0], " rad/s, angle ", largest[1],
          " rad; of the reference itself ", static_cast<double>(error));
  CHECK(error < 1e-12L);
  for (const double difference : largest) CHECK(difference <= 1e-6);
}

TEST_CASE("cartpole: one MuJoCo step is the ODE to 1e-6 for 1,000 random states and actions") {
  long double error;
  const auto largest =
      LargestDifference<CartpoleOde, 4>(MakeTask("cartpole"), {5, 3, 15, 2 * kPi}, &error);
  MESSAGE("largest difference: cart velocity ", largest[0], " m/s, position ", largest[1],
          " m, pole velocity ", largest[2], " rad/s, angle ", largest[3],
          " rad; of the reference itself ", static_cast<double>(error));
  CHECK(error < 1e-12L);
  for (const double difference : largest) CHECK(difference <= 1e-6);
}

TEST_CASE("swing-ups: hanging at rest stays exactly at rest, upright at rest stays to rounding") {
  for (const std::string name : {"pendulum", "cartpole"}) {
    CAPTURE(name);
    const Task task = MakeTask(name);
    const std::unique_ptr<System> system = task.make_system();
    const std::vector<double> action(task.n_actions(), 0.0);
    std::vector<double> state(task.n_states(), 0.0);
    system->Reset(state);
    for (int t = 0; t < task.horizon; ++t) system->Step(action, state);
    for (const double variable : state) CHECK(variable == 0);

    state.back() = kPi;
    system->Reset(state);
    for (int t = 0; t < 10; ++t) system->Step(action, state);
    // sin(fl(pi)) = 1.2e-16 grows as exp(t sqrt(g_effective / l)), at most exp(7.7) in 1 s.
    CHECK(std::abs(state.back() - kPi) < 1e-12);
  }
}

TEST_CASE("pendulum: a constant torque holds the angle asin(2 u / (m g l))") {
  const std::unique_ptr<System> system = MakeTask("pendulum").make_system();
  const double torque = 2.5;
  std::array<double, 2> state = {0, std::asin(2 * torque / kGravity)};
  const double angle = state[1];
  system->Reset(state);
  for (int t = 0; t < 40; ++t) system->Step({&torque, 1}, state);
  CHECK(std::abs(state[0]) < 1e-13);
  CHECK(std::abs(state[1] - angle) < 1e-13);
}

TEST_CASE("cartpole: the force b v keeps cart and hanging pole at the speed v") {
  const std::unique_ptr<System> system = MakeTask("cartpole").make_system();
  const double force = 0.1 * 2;
  std::array<double, 4> state = {2, -1, 0, 0};
  system->Reset(state);
  for (int t = 0; t < 10; ++t) system->Step({&force, 1}, state);
  CHECK(std::abs(state[0] - 2) < 1e-12);
  CHECK(std::abs(state[1] - 1) < 1e-12);
  CHECK(std::abs(state[2]) < 1e-12);
  CHECK(std::abs(state[3]) < 1e-12);
}

TEST_CASE("cartpole: a push to the right leaves the tip behind") {
  const std::unique_ptr<System> system = MakeTask("cartpole").make_system();
  const double force = 10;
  std::array<double, 4> state = {0, 0, 0, 0};
  system->Reset(state);
  system->Step({&force, 1}, state);
  CHECK(state[1] > 0);
  CHECK(state[3] < 0);
  CHECK(state[1] + 0.5 * std::sin(state[3]) < state[1]);
}

// Kinetic and potential energy of the two bodies, J.
double CartpoleEnergy(const std::array<double, 4>& y) {
  const double m = 0.5, cart = 0.5, l = 0.5;
  const double c = std::cos(y[3]);
  return (cart + m) * y[0] * y[0] / 2 + m * l * y[0] * y[2] * c / 2 + m * l * l * y[2] * y[2] / 6 -
         m * kGravity * l * c / 2;
}

TEST_CASE("cartpole: the energy lost is the work of the cart's friction") {
  const std::unique_ptr<System> system = MakeTask("cartpole").make_system();
  const double force = 0;
  const std::array<double, 4> start = {1, 0, -6, 2};
  std::array<double, 4> state = start;
  // The work is a fifth variable of the ODE: d work / dt = b v^2.
  const auto ode = [](const std::array<long double, 5>& y) {
    const auto d = CartpoleOde{0}({y[0], y[1], y[2], y[3]});
    return std::array<long double, 5>{d[0], d[1], d[2], d[3], 0.1L * y[0] * y[0]};
  };
  long double error;
  const auto end = SolveOde(ode, std::array<long double, 5>{1, 0, -6, 2, 0}, 1.0L, 100, &error);
  system->Reset(state);
  for (int t = 0; t < 10; ++t) system->Step({&force, 1}, state);
  const double lost = CartpoleEnergy(start) - CartpoleEnergy(state);
  CHECK(lost > 0.01);
  CHECK(std::abs(lost - static_cast<double>(end[4])) < 1e-6);
}

TEST_CASE("system: equal starts and actions give equal bits, whatever came before") {
  for (const std::string& name : TaskNames()) {
    CAPTURE(name);
    const Task task = MakeTask(name);
    const std::unique_ptr<System> used = task.make_system();
    const std::vector<double> action(task.n_actions(), 1.25);
    std::vector<double> first(task.n_states()), second(task.n_states());
    const std::vector<double> start(task.n_states(), 0.5);
    used->Reset(std::vector<double>(task.n_states(), -3.0));
    for (int t = 0; t < 7; ++t) used->Step(action, first);
    const std::unique_ptr<System> fresh = task.make_system();
    used->Reset(start);
    fresh->Reset(start);
    for (int t = 0; t < task.horizon; ++t) {
      used->Step(action, first);
      fresh->Step(action, second);
      CHECK(first == second);
    }
  }
}

TEST_CASE("system: an action or state that is not finite gives NaN until the next Reset") {
  for (const std::string& name : TaskNames()) {
    CAPTURE(name);
    const Task task = MakeTask(name);
    const std::unique_ptr<System> system = task.make_system();
    const auto all_nan = [](const std::vector<double>& state) {
      return std::all_of(state.begin(), state.end(), [](double v) { return std::isnan(v); });
    };
    const std::vector<double> good(task.n_actions(), 1.0), bad(task.n_actions(), std::nan(""));
    std::vector<double> state(task.n_states(), 0.0);
    system->Reset(state);
    system->Step(bad, state);
    CHECK(all_nan(state));
    system->Step(good, state);
    CHECK(all_nan(state));
    system->Reset(state);
    system->Step(good, state);
    CHECK(all_nan(state));
    system->Reset(std::vector<double>(task.n_states(), 0.0));
    system->Step(good, state);
    for (const double variable : state) CHECK(std::isfinite(variable));
  }
}

}  // namespace
}  // namespace downpour
