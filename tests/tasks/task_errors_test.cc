// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>
#include <mujoco/mujoco.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include "engine/errors.h"
#include "tasks/registry.h"
#include "tests/temporary_directory.h"

namespace downpour {
namespace {

// The message of the InvalidInput that `action` throws, "" if it throws none.
std::string MessageOf(const std::function<void()>& action) {
  try {
    action();
  } catch (const InvalidInput& error) {
    return error.what();
  }
  return "";
}

bool Contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// A pendulum in MJCF with these parts.
std::string Pendulum(const std::string& joint, const std::string& actuator,
                     const std::string& option = R"(timestep="0.01")") {
  return "<mujoco><option " + option + "/><worldbody><body>" + joint +
         R"(<inertial pos="0 0 -0.5" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody>)" +
         "<actuator>" + actuator + "</actuator></mujoco>";
}

const std::string kJoint = R"(<joint name="pole" type="hinge" axis="0 -1 0"/>)";
const std::string kMotor = R"(<motor name="torque" joint="pole"/>)";

TEST_CASE("registry: names the tasks and refuses others, listing what is allowed") {
  const std::vector<std::string> names = TaskNames();
  for (const std::string name : {"pendulum", "cartpole"}) {
    CHECK_MESSAGE(std::count(names.begin(), names.end(), name) == 1, name);
  }
  for (const std::string name : {"", "Pendulum", "no such task", "cartpole "}) {
    const std::string message = MessageOf([&] { MakeTask(name); });
    CHECK(Contains(message, "'" + name + "'"));
    for (const std::string& allowed : names) CHECK(Contains(message, allowed));
  }
}

TEST_CASE("registry: refuses unknown presets, listing what is allowed") {
  for (const std::string name : {"pendulum", "cartpole"}) {
    for (const std::string preset : {"Paper", "original"}) {
      const std::string message = MessageOf([&] { MakeTask(name, preset); });
      CHECK(Contains(message, "'" + preset + "'"));
      CHECK(Contains(message, "allowed: paper, original-code"));
    }
  }
}

TEST_CASE("system: the digest tells models apart, by the text in use and the files it names") {
  const TemporaryDirectory folder;
  const auto digest = [](const std::string& task, const std::string& file = "") {
    return MakeTask(task, "paper", file).model_digest;
  };
  CHECK(digest("pendulum").size() == 16);
  CHECK(digest("pendulum") == digest("pendulum"));
  CHECK(digest("pendulum") != digest("cartpole"));
  const std::string file = folder.Write("model.xml", Pendulum(kJoint, kMotor));
  const std::string first = digest("pendulum", file);
  CHECK(first.size() == 16);
  CHECK(first != digest("pendulum"));
  folder.Write("model.xml", Pendulum(kJoint, kMotor, R"(timestep="0.01" gravity="0 0 -5")"));
  CHECK(digest("pendulum", file) != first);
  folder.Write("model.xml", Pendulum(kJoint, kMotor));
  CHECK(digest("pendulum", file) == first);
  folder.Write("model.xml", "<mujoco><include file = 'part.xml'/></mujoco>");
  const std::string part = (folder.path() / "part.xml").string();
  std::ofstream(part) << "<mujoco/>";
  const std::string included = digest("pendulum", file);
  std::ofstream(part) << "<mujoco><option gravity='0 0 -5'/></mujoco>";
  CHECK(digest("pendulum", file) != included);
  // A file that names itself, and one that is not there.
  std::ofstream(part) << "<mujoco><include file=\"part.xml\"/></mujoco>";
  CHECK(digest("pendulum", file).size() == 16);
  CHECK(digest("pendulum", (folder.path() / "none.xml").string()) == "");
}

TEST_CASE("system: a model file replaces the built-in one") {
  const TemporaryDirectory folder;
  // Without gravity a pole keeps the speed it has.
  const std::string file =
      folder.Write("model.xml", Pendulum(kJoint, kMotor, R"(timestep="0.05" gravity="0 0 0")"));
  const std::unique_ptr<System> system = MakeTask("pendulum", "paper", file).make_system();
  std::array<double, 2> state = {3, 1};
  const double torque = 0;
  system->Reset(state);
  system->Step({&torque, 1}, state);
  CHECK(state[0] == doctest::Approx(3));
  CHECK(state[1] == doctest::Approx(1.3));
}

TEST_CASE("system: a model that cannot be used is refused in one line with file and reason") {
  const std::string other_joint = R"(<joint name="hinge" type="hinge" axis="0 -1 0"/>)";
  const std::string ball_joint = R"(<joint name="pole" type="ball"/>)";
  const std::string other_motor = R"(<motor name="motor" joint="pole"/>)";
  struct Case {
    std::string mjcf;
    std::vector<std::string> parts;
  };
  const std::vector<Case> cases = {
      {"", {"EMPTY_DOCUMENT", "allowed: an MJCF model"}},
      {"<mujoco", {"XML", "allowed: an MJCF model"}},
      {"not xml at all", {"XML", "allowed"}},
      {"<robot/>", {"allowed"}},
      {"<mujoco><wheel/></mujoco>", {"unrecognized element", "wheel"}},
      {"<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", {"mass and inertia"}},
      {"<mujoco/>", {"no joint named pole", "allowed: exactly the joints pole"}},
      {Pendulum(other_joint, ""), {"no joint named pole", "allowed: exactly the joints pole"}},
      {Pendulum(kJoint + R"(<joint name="second" axis="1 0 0"/>)", kMotor),
       {"has 2 joints", "allowed: exactly the joints pole"}},
      {Pendulum(kJoint, ""), {"no actuator named torque", "exactly the actuators torque"}},
      {Pendulum(kJoint, other_motor), {"no actuator named torque"}},
      {Pendulum(kJoint, kMotor + other_motor), {"has 2 actuators"}},
      {Pendulum(ball_joint, kMotor), {"joint pole", "allowed: slide, hinge"}},
      {Pendulum(kJoint, kMotor, R"(timestep="0.03")"), {"timestep 0.03 s", "period 0.1 s"}},
      {Pendulum(kJoint, kMotor, R"(timestep="0.2")"), {"timestep 0.2 s"}},
      {Pendulum(kJoint, kMotor, R"(timestep="0")"), {"timestep 0 s"}},
      {Pendulum(kJoint, kMotor, R"(timestep="-0.01")"), {"timestep -0.01 s"}},
      {Pendulum(kJoint, kMotor, R"(timestep="1e-9")"), {"timestep 1e-09 s"}},
  };
  const TemporaryDirectory folder;
  for (const Case& c : cases) {
    CAPTURE(c.mjcf);
    const std::string file = folder.Write("model.xml", c.mjcf);
    const Task task = MakeTask("pendulum", "paper", file);
    const std::string message = MessageOf([&] { task.make_system(); });
    CAPTURE(message);
    CHECK(message.starts_with(file + ": "));
    CHECK(Contains(message, "allowed: "));
    CHECK_FALSE(Contains(message, "\n"));
    for (const std::string& part : c.parts) CHECK(Contains(message, part));
  }
}

TEST_CASE("system: an actuator that clips the task's actions is refused, a wider one is not") {
  const TemporaryDirectory folder;
  const auto message_of = [&](const std::string& range) {
    const std::string motor =
        R"(<motor name="torque" joint="pole" ctrllimited="true" ctrlrange=")" + range + R"("/>)";
    const std::string file = folder.Write("model.xml", Pendulum(kJoint, motor));
    return MessageOf([&] { MakeTask("pendulum", "paper", file).make_system(); });
  };
  CHECK(message_of("-2.5 2.5") == "");
  CHECK(message_of("-9 3") == "");
  CHECK(message_of("-1 1") ==
        (folder.path() / "model.xml").string() +
            ": actuator torque has ctrlrange -1 to 1; allowed: one that contains -2.5 to 2.5, the "
            "task's action limits, or ctrllimited=\"false\"");
  CHECK(Contains(message_of("0 2.5"), "ctrlrange 0 to 2.5"));
  CHECK(Contains(message_of("-2.5 2.4"), "ctrlrange -2.5 to 2.4"));
}

TEST_CASE("system: a model file that cannot be read is refused by name") {
  const TemporaryDirectory folder;
  const std::string missing = (folder.path() / "missing.xml").string();
  const auto message_of = [](const std::string& file) {
    return MessageOf([&] { MakeTask("cartpole", "paper", file).make_system(); });
  };
  const std::string allowed = "; allowed: a readable MJCF file";
  CHECK(message_of(missing) == missing + ": cannot be read (No such file or directory)" + allowed);
  CHECK(message_of(folder.path().string()) ==
        folder.path().string() + ": cannot be read (Is a directory)" + allowed);
}

TEST_CASE("system: MuJoCo's errors are exceptions and its warnings leave no log file") {
  const TemporaryDirectory folder;
  const std::filesystem::path before = std::filesystem::current_path();
  std::filesystem::current_path(folder.path());
  const std::unique_ptr<System> system = MakeTask("pendulum").make_system();
  CHECK(MessageOf([] { mju_error("two\nlines"); }) == "two lines");
  mju_warning("a warning");
  const double torque = std::numeric_limits<double>::infinity();
  std::array<double, 2> state = {0, 0};
  system->Reset(state);
  system->Step({&torque, 1}, state);  // MuJoCo warns of an unstable simulation
  CHECK(std::filesystem::is_empty(folder.path()));
  std::filesystem::current_path(before);
}

TEST_CASE("system: models load and step in several threads at once") {
  const Task task = MakeTask("cartpole");
  std::vector<std::array<double, 4>> ends(4);
  std::vector<std::thread> threads;
  for (std::array<double, 4>& end : ends) {
    threads.emplace_back([&task, &end] {
      const double force = 3;
      for (int i = 0; i < 10; ++i) {
        const std::unique_ptr<System> system = task.make_system();
        system->Reset(task.start_mean);
        for (int t = 0; t < task.horizon; ++t) system->Step({&force, 1}, end);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (const std::array<double, 4>& end : ends) CHECK(end == ends[0]);
}

}  // namespace
}  // namespace downpour
