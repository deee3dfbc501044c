// SPDX-License-Identifier: Apache-2.0
#include "tasks/mujoco_prior.h"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "kernels/aligned.h"
#include "kernels/philox/philox.h"
#include "tasks/registry.h"
#include "tests/temporary_directory.h"

namespace downpour {
namespace {

// A cart-pole in MJCF as text to change.
const std::string kModel = R"(<mujoco>
  <compiler angle="radian" inertiafromgeom="false"/>
  <option timestep="0.02" integrator="RK4" gravity="0 0 -9.82"><flag contact="disable"/></option>
  <worldbody><body name="cart">
    <joint name="cart" type="slide" axis="1 0 0" damping="0.1" frictionloss="0.05"/>
    <inertial pos="0 0 0" mass="0.5" diaginertia="0.001 0.001 0.001"/>
    <body name="pole">
      <joint name="pole" type="hinge" axis="0 -1 0" damping="0.01" stiffness="0.2" armature="0.001"/>
      <inertial pos="0 0 -0.25" mass="0.5" diaginertia="0.01 0.01 0.001"/>
      <body name="weight" pos="0 0 -0.5">
        <inertial pos="0 0 0" mass="0.1" diaginertia="0.0001 0.0001 0.0001"/>
      </body>
    </body>
  </body></worldbody>
  <actuator><motor name="force" joint="cart" gear="1"/></actuator></mujoco>)";

std::string Replaced(std::string text, const std::string& old, const std::string& now) {
  const std::size_t at = text.find(old);
  REQUIRE(at != std::string::npos);
  return text.replace(at, old.size(), now);
}

// States and actions of cart-pole for one tile.
struct Tile {
  Tile() : states(4 * kTileLanes), actions(kTileLanes), next(4 * kTileLanes) {
    FillNormals({3, 4}, 0, states.data(), states.size());
    FillNormals({5, 6}, 0, actions.data(), actions.size());
    for (double& state : states) state *= 3;
  }
  AlignedVector<double> states, actions, next;
};

// What a new system of the model says of the tile's lanes, one after the other.
AlignedVector<double> BySystem(const std::string& file, const Tile& tile) {
  const auto system = MakeTask("cartpole", "paper", file).make_system();
  AlignedVector<double> next(tile.next.size());
  std::vector<double> state(4);
  for (int lane = 0; lane < kTileLanes; ++lane) {
    for (int e = 0; e < 4; ++e) state[e] = tile.states[e * kTileLanes + lane];
    system->Reset(state);
    system->Step(std::array{tile.actions[lane]}, state);
    for (int e = 0; e < 4; ++e) next[e * kTileLanes + lane] = state[e];
  }
  return next;
}

TEST_CASE("mujoco_prior: predicts the very bits of the system with the same model") {
  const TemporaryDirectory folder;
  const std::string file = folder.Write("model.xml", kModel);
  Tile tile;
  const auto prior = MakeTask("cartpole").make_prior(file, "");
  const auto predictor = prior->MakePredictor();
  predictor->SetParameters({});
  // What was there before, broken lanes too, leaves no trace.
  Tile broken;
  for (int lane = 0; lane < kTileLanes; lane += 2) broken.states[lane] = 1e300;
  predictor->PredictTile(kTileLanes, broken.states.data(), broken.actions.data(),
                         broken.next.data());
  for (int lane = 0; lane < kTileLanes; ++lane) {
    CHECK(std::isfinite(broken.next[lane]) == (lane % 2 == 1));
  }
  predictor->PredictTile(kTileLanes, tile.states.data(), tile.actions.data(), tile.next.data());
  const AlignedVector<double> wanted = BySystem(file, tile);
  CHECK(tile.next == wanted);
  // In place, and the first lanes only.
  AlignedVector<double> states = tile.states;
  predictor->PredictTile(5, states.data(), tile.actions.data(), states.data());
  for (int i = 0; i < 4 * kTileLanes; ++i) {
    CHECK(states[i] == (i % kTileLanes < 5 ? wanted[i] : tile.states[i]));
  }
}

TEST_CASE("mujoco_system: Place and Reset lead to the same bits, joint limits and all") {
  for (const std::string& name : TaskNames()) {
    const Task task = MakeTask(name);
    // Of the model built in, and once more with what the solver was warm-started with in between.
    const TemporaryDirectory folder;
    std::vector<double> state(task.n_states()), action(task.n_actions());
    const auto system = task.make_system();
    auto* const placed = dynamic_cast<MujocoSystem*>(system.get());
    REQUIRE(placed != nullptr);
    const auto other = task.make_system();
    for (std::uint32_t i = 0; i < 50; ++i) {
      FillNormals({1, i}, 0, state.data(), state.size());
      FillUniforms({2, i}, 0, action.data(), action.size());
      std::vector<double> next = state, wanted = state;
      placed->Place(state);
      placed->Step(action, next);
      other->Reset(state);
      other->Step(action, wanted);
      CHECK_MESSAGE(next == wanted, name << " " << i);
    }
  }
}

TEST_CASE("mujoco_prior: each parameter does what the same number in the file does") {
  struct Change {
    std::string free;
    double value;
    std::vector<std::array<std::string, 2>> replacements;
  };
  const std::string pole = R"(mass="0.5" diaginertia="0.01 0.01 0.001"/>
      <body)";
  const std::vector<Change> changes = {
      {"pole:mass", 0.3, {{pole, R"(mass="0.3" diaginertia="0.006 0.006 0.0006"/>
      <body)"}}},
      {"pole:length",
       1.5,
       {{R"(pos="0 0 -0.25")", R"(pos="0 0 -0.375")"},
        {pole, R"(mass="0.5" diaginertia="0.0225 0.0225 0.00225"/>
      <body)"},
        {R"(pos="0 0 -0.5")", R"(pos="0 0 -0.75")"}}},
      {"cart:damping", 0.2, {{R"(damping="0.1")", R"(damping="0.2")"}}},
      {"cart:friction=0..1", 0.7, {{R"(frictionloss="0.05")", R"(frictionloss="0.7")"}}},
      {"pole:friction=0..1", 0.2, {{R"(damping="0.01")", R"(damping="0.01" frictionloss="0.2")"}}},
      {"pole:stiffness", 0.25, {{R"(stiffness="0.2")", R"(stiffness="0.25")"}}},
      {"pole:armature", 0.002, {{R"(armature="0.001")", R"(armature="0.002")"}}},
      {"force:gear", 0.8, {{R"(gear="1")", R"(gear="0.8")"}}}};
  const TemporaryDirectory folder;
  const std::string file = folder.Write("model.xml", kModel);
  const Tile tile;
  for (const Change& change : changes) {
    std::string text = kModel;
    for (const auto& replacement : change.replacements) {
      text = Replaced(text, replacement[0], replacement[1]);
    }
    const AlignedVector<double> wanted = BySystem(folder.Write("changed.xml", text), tile);
    const auto prior = MakeTask("cartpole").make_prior(file, change.free);
    REQUIRE(prior->parameters().size() == 1);
    const auto predictor = prior->MakePredictor();
    AlignedVector<double> next(tile.next.size());
    // Set twice: a value does not build on the one before.
    predictor->SetParameters(std::array{prior->parameters()[0].high});
    predictor->SetParameters(std::array{change.value});
    predictor->PredictTile(kTileLanes, tile.states.data(), tile.actions.data(), next.data());
    double worst = 0;
    for (std::size_t i = 0; i < next.size(); ++i) {
      worst = std::max(worst, std::abs(next[i] - wanted[i]) / std::max(1.0, std::abs(wanted[i])));
    }
    // Masses and inertias are rounded in another order: some eps, which the pole's swing grows. The
    // solver of friction stops at a residual of 1e-8.
    const bool friction = change.free.find("friction") != std::string::npos;
    CHECK_MESSAGE(worst < (friction ? 1e-6 : 1e-12), change.free << " " << worst);
    CHECK_MESSAGE(next != BySystem(file, tile), change.free);
  }
}

TEST_CASE("mujoco_prior: names, units, ranges and starts of its parameters") {
  const TemporaryDirectory folder;
  const std::string file = folder.Write("model.xml", kModel);
  const auto prior = MakeTask("cartpole")
                         .make_prior(file,
                                     "pole:mass, cart:damping = 0 .. 0.5,pole:damping,"
                                     "pole:length=0.5..3,force:gear");
  const auto& p = prior->parameters();
  REQUIRE(p.size() == 5);
  CHECK((p[0].name == "pole:mass" && p[0].unit == "kg"));
  CHECK((p[0].low == 0.25 && p[0].high == 1 && p[0].initial == 0.5));
  CHECK((p[1].name == "cart:damping" && p[1].unit == "N s/m"));
  CHECK((p[1].low == 0 && p[1].high == 0.5 && p[1].initial == 0.1));
  CHECK(p[2].unit == "N m s/rad");
  CHECK((p[3].unit == "1" && p[3].low == 0.5 && p[3].high == 3 && p[3].initial == 1));
  CHECK(p[4].initial == 1);
  CHECK(MakeTask("cartpole").make_prior(file, " ")->parameters().empty());
  // All that a resumed run must agree in.
  const auto describe = [&](const std::string& f, const std::string& free) {
    return MakeTask("cartpole").make_prior(f, free)->Describe();
  };
  CHECK(describe(file, "pole:mass") == describe(file, "pole:mass=0.25..1"));
  CHECK(describe(file, "pole:mass") != describe(file, "pole:mass=0.25..2"));
  CHECK(describe(file, "pole:mass") != describe(file, "cart:mass"));
  const std::string other = folder.Write("other.xml", Replaced(kModel, "9.82", "9.81"));
  CHECK(describe(file, "") != describe(other, ""));
}

TEST_CASE("mujoco_prior: bad models and lists are refused in one line that says what is allowed") {
  const TemporaryDirectory folder;
  const std::string file = folder.Write("model.xml", kModel);
  const auto message = [](const std::string& model, const std::string& free) -> std::string {
    try {
      MakeTask("cartpole").make_prior(model, free);
    } catch (const InvalidInput& error) {
      return error.what();
    }
    return "";
  };
  struct Bad {
    std::string model, free;
    std::vector<std::string> parts;
  };
  const std::string frictionless =
      folder.Write("frictionless.xml", Replaced(kModel, R"(damping="0.1")", ""));
  const std::vector<Bad> all = {
      {"/nowhere/model.xml", "", {"/nowhere/model.xml", "cannot be read"}},
      {folder.Write("broken.xml", "<mujoco>"), "", {"broken.xml", "MuJoCo"}},
      {folder.Write("joint.xml", Replaced(kModel, R"(joint name="pole")", R"(joint name="rod")")),
       "",
       {"joint.xml", "no joint named pole", "allowed"}},
      {folder.Write("step.xml", Replaced(kModel, "0.02", "0.03")), "", {"step.xml", "timestep"}},
      {file, "pole", {"\"pole\"", "OBJECT:QUANTITY"}},
      {file, ":mass", {"OBJECT:QUANTITY"}},
      {file, "pole:mass,,cart:mass", {"OBJECT:QUANTITY"}},
      {file, "pole:mas", {"unknown quantity mas", "mass, length, damping"}},
      {file, "rod:mass", {"no body named rod", "cart, pole, weight"}},
      {file, "world:mass", {"no body named world"}},
      {file, "weight:damping", {"no joint named weight", "cart, pole"}},
      {file, "cart:gear", {"no actuator named cart", "force"}},
      {file, "pole:mass,pole:mass=0.1..1", {"once"}},
      {file, "pole:mass=1..0.1", {"LOW < HIGH"}},
      {file, "pole:mass=0..1", {"above 0"}},
      {file, "pole:damping=-1..1", {"not below 0"}},
      {file, "pole:mass=0.1", {"LOW..HIGH"}},
      {file, "pole:mass=", {"LOW..HIGH"}},
      {file, "pole:mass=a..b", {"LOW..HIGH"}},
      {file, "pole:mass=0.1..inf", {"LOW..HIGH"}},
      {file, "pole:mass=0.1..nan", {"LOW..HIGH"}},
      {file, "pole:mass=0.6..1", {"is 0.5 in the model", "contain"}},
      {frictionless, "cart:damping", {"is 0 in the model", "=LOW..HIGH"}}};
  for (const Bad& bad : all) {
    const std::string found = message(bad.model, bad.free);
    CHECK_MESSAGE(found.find('\n') == std::string::npos, found);
    for (const std::string& part : bad.parts) {
      CHECK_MESSAGE(found.find(part) != std::string::npos, bad.free << ": " << found);
    }
  }
  CHECK(message(frictionless, "cart:damping=0..1").empty());
}

TEST_CASE("mujoco_prior: a file that changes under a run is refused") {
  const TemporaryDirectory folder;
  const std::string file = folder.Write("model.xml", kModel);
  const auto prior = MakeTask("cartpole").make_prior(file, "pole:mass");
  CHECK_NOTHROW(prior->MakePredictor());
  folder.Write("model.xml", Replaced(kModel, "9.82", "9.81"));
  CHECK_THROWS_AS(prior->MakePredictor(), InvalidInput);
}

}  // namespace
}  // namespace downpour
