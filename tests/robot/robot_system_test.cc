// SPDX-License-Identifier: Apache-2.0
#include "engine/robot/robot_system.h"

#include <doctest/doctest.h>

#include <functional>
#include <string>

#include "engine/learner/atomic_file.h"
#include "engine/learner/execute.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

constexpr const char* kHello =
    R"({"type":"hello","protocol":1,"n_states":2,"n_actions":1,"control_period":0.1,)"
    R"("action_limits":[2]})";
constexpr const char* kStart = R"({"type":"start","episode":3,"observation":[0.5,0.25]})";

std::string Observation(int step, const std::string& rest) {
  return R"({"type":"observation","step":)" + std::to_string(step) + "," + rest + "}";
}

// A robot that gives these answers, one a question, writes what it was asked into `log`, and goes
// when its input ends.
RobotOptions Answering(const std::vector<std::string>& answers, const std::string& log = "") {
  RobotOptions options;
  const std::string script =
      "log=$1; shift; for a; do read -r q || exit 9; [ -z \"$log\" ] || echo \"$q\" >>\"$log\"; "
      "printf '%s\\n' \"$a\"; done; "
      "while read -r q; do [ -z \"$log\" ] || echo \"$q\" >>\"$log\"; done";
  options.command = {"sh", "-c", script, "robot", log};
  options.command.insert(options.command.end(), answers.begin(), answers.end());
  options.step_timeout = 60;
  return options;
}

std::string HelloError(const std::string& answer) {
  return ErrorOf<InvalidInput>([&] { MakeRobotSystem(PointMassTask(), Answering({answer})); });
}

// What a robot's answer to the first step is refused for.
std::string StepError(const std::string& answer, const std::string& hello = kHello) {
  const auto system = MakeRobotSystem(PointMassTask(), Answering({hello, kStart, answer}));
  double state[2];
  system->Begin(3, std::vector<double>{0, 0}, state);
  return ErrorOf<SystemFailure>([&] { system->Step(std::vector<double>{1}, state); });
}

std::string ReplaceAll(std::string text, const std::string& from, const std::string& to) {
  for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size()) {
    text.replace(at, from.size(), to);
  }
  return text;
}

TEST_CASE("robot: an episode, line by line") {
  const TemporaryDirectory directory;
  const std::string log = (directory.path() / "log").string();
  Task task = PointMassTask();
  task.horizon = 3;
  {
    const auto system = MakeRobotSystem(
        task, Answering({kHello, kStart, Observation(0, R"("observation":[1,2],"reward":0.5)"),
                         Observation(1, R"("observation":[0.1,1e-300],"done":false)"),
                         Observation(2, R"("observation":[3,4],"reward":0.25,"done":true)")},
                        log));
    CHECK(system->measured());
    const Execution execution = ExecuteEpisode(
        task, *system, 3, {1, 2}, {3, 4},
        [](int step, std::span<const double>, std::span<double> a) { a[0] = step - 4.0 / 3; });
    REQUIRE(execution.transitions.size() == 3);
    CHECK(execution.transitions[0].observation == std::vector<double>{0.5, 0.25});
    CHECK(execution.transitions[1].next_observation == std::vector<double>{0.1, 1e-300});
    CHECK(execution.transitions[0].reward == 0.5);
    CHECK(execution.transitions[1].reward == doctest::Approx(std::exp(-2)).epsilon(1e-12));
    CHECK(execution.transitions[2].reward == 0.25);
    CHECK(execution.outcome == "complete");
  }
  double z[2];
  FillNormals({1, 2}, 0, z, 2);
  const std::string start = nlohmann::json(std::vector<double>{0.1 * z[0], 0.2 * z[1]}).dump();
  CHECK(
      ReadFile(log) ==
      R"({"type":"hello","protocol":1,"task":"point_mass","states":[{"name":"velocity","unit":"m/s"},)"
      R"({"name":"position, \"x\"","unit":"m"}],"actions":[{"name":"force","unit":"N","limit":2.0}],)"
      R"("control_period":0.1,"horizon":3})"
      "\n"
      R"({"type":"reset","episode":3,"start":)" +
          start +
          "}\n"
          R"({"type":"step","step":0,"action":[-1.3333333333333333]})"
          "\n"
          R"({"type":"step","step":1,"action":[-0.33333333333333326]})"
          "\n"
          R"({"type":"step","step":2,"action":[0.6666666666666667]})"
          "\n"
          R"({"type":"end"})"
          "\n"
          R"({"type":"close"})"
          "\n");
}

TEST_CASE("robot: a hello that does not suit the task is refused by field, value and why") {
  const auto with = [](const char* from, const char* to) {
    return HelloError(ReplaceAll(kHello, from, to));
  };
  const std::string at = "the robot's hello: ";
  CHECK(HelloError(kHello) == "");
  CHECK(with("\"protocol\":1", "\"protocol\":2") ==
        at + "protocol = 2: must be 1, the version of the protocol");
  CHECK(with("\"n_states\":2", "\"n_states\":3") ==
        at + "n_states = 3: must be 2, as task point_mass has");
  CHECK(with("\"n_states\":2,", "") == at + "n_states is missing");
  CHECK(with("\"n_actions\":1", "\"n_actions\":\"1\"") ==
        at + "n_actions = \"1\": must be 1, as task point_mass has");
  CHECK(with("0.1", "0.05") ==
        at + "control_period = 0.05: must be 0.1 s, the task's control period");
  CHECK(with("0.1", "\"nan\"") ==
        at + "control_period = \"nan\": must be 0.1 s, the task's control period");
  CHECK(with("0.1", "0.10000000000000001") == "");
  CHECK(with("[2]", "[3]") == "");
  CHECK(with("[2]", "[1.5]") ==
        at + "action_limits[0] = 1.5: must be at least 2, the task's limit of force");
  CHECK(with("[2]", "[2,2]") == at + "action_limits = [2,2]: must be an array of 1 numbers");
  CHECK(with("[2]", "[2],\"observation_limits\":[1,0]") ==
        at + "observation_limits[1] = 0: must be in (0, 1e+06]");
  CHECK(HelloError(kStart) == "the robot's answer: type = \"start\": must be \"hello\"");
}

TEST_CASE("robot: answers that are none are refused, the words of the program quoted") {
  const std::string at = "the robot's answer: ";
  CHECK(StepError(Observation(0, "\"observation\":[1,2],\"extra\":{\"is\":[\"fine\"]}")) == "");
  CHECK(StepError(Observation(1, "\"observation\":[1,2]")) == at + "step = 1: must be 0");
  CHECK(StepError(R"({"type":"observation","observation":[1,2]})") == at + "step is missing");
  CHECK(StepError(kStart) == at + "type = \"start\": must be \"observation\"");
  CHECK(StepError(Observation(0, "\"observation\":[1]")) ==
        at + "observation = [1]: must be an array of 2 numbers");
  CHECK(StepError(Observation(0, "\"observation\":[1,null]")) ==
        at + "observation[1] = null: must be a number");
  CHECK(StepError(Observation(0, "\"observation\":[\"nan\",1]")) ==
        at + "observation[0] = \"nan\": must be within +-1e+06");
  CHECK(StepError(Observation(0, "\"observation\":[-1000000,1000000]")) == "");
  CHECK(StepError(Observation(0, "\"observation\":[1,1000000.1]")) ==
        at + "observation[1] = 1000000.1: must be within +-1e+06");
  CHECK(StepError(Observation(0, "\"observation\":[1,2],\"reward\":\"inf\"")) ==
        at + "reward = \"inf\": must be within +-1e+06");
  CHECK(StepError(Observation(0, "\"observation\":[1,2],\"done\":1")) ==
        at + "done = 1: must be true or false");
  const std::string limited = ReplaceAll(kHello, "[2]", "[2],\"observation_limits\":[9,1]");
  CHECK(StepError(Observation(0, "\"observation\":[8,-1.5]"), limited) ==
        at + "observation[1] = -1.5: must be within +-1");
  const std::string none = "the robot's program sent no message of the protocol: ";
  CHECK(StepError("motor \x1b[31m ready") == none + "\"motor \\u001b[31m ready\"");
  CHECK(StepError("") == none + "\"\"");
  CHECK(StepError("[]") == none + "\"[]\"");
  CHECK(StepError("\xff") == none + "\"\xef\xbf\xbd\"");
  CHECK(StepError(Observation(0, "\"observation\":[1e999,2]")) ==
        none + nlohmann::json(Observation(0, "\"observation\":[1e999,2]")).dump());
  CHECK(StepError("{\"type\":" + std::string(300, '[') + std::string(300, ']') + "}") ==
        none + "\"{\\\"type\\\":" + std::string(72, '[') + "...\"");
  CHECK(StepError(R"({"type":"error","message":"out\nof \"film\""})") ==
        R"(the robot reports "out\nof \"film\"")");
  CHECK(StepError(R"({"type":"error"})") == at + "message is missing");
}

TEST_CASE("robot: a line that nothing asked for is refused at the next question") {
  const auto system =
      MakeRobotSystem(PointMassTask(), Answering({std::string(kHello) + "\n" + kStart}));
  double state[2];
  const std::string error = ErrorOf<SystemFailure>([&] {
    system->Begin(3, std::vector<double>{0, 0}, state);
  });
  CHECK(Contains(error, "the robot's program sent a line that nothing asked for: "));
}

TEST_CASE("robot: after a failure the next episode starts the program again") {
  const auto system = MakeRobotSystem(PointMassTask(), Answering({kHello, kStart, "nonsense"}));
  double state[2];
  for (int i = 0; i < 2; ++i) {
    system->Begin(3, std::vector<double>{0, 0}, state);
    CHECK(state[1] == 0.25);
    CHECK_THROWS_AS(system->Step(std::vector<double>{1}, state), SystemFailure);
    CHECK(ErrorOf<SystemFailure>([&] { system->Step(std::vector<double>{1}, state); }) ==
          "the robot's program is not running");
  }
}

TEST_CASE("robot: a robot that is too slow has failed, one that has five periods' time has not") {
  RobotOptions options = Answering({kHello, kStart});
  options.step_timeout = 0;  // five control periods
  const auto system = MakeRobotSystem(PointMassTask(), options);
  double state[2];
  system->Begin(3, std::vector<double>{0, 0}, state);
  CHECK(ErrorOf<SystemFailure>([&] { system->Step(std::vector<double>{1}, state); }) ==
        "the robot's program gave no answer within 0.5 s");
  options = Answering({});
  options.setup_timeout = 0.1;
  CHECK(ErrorOf<SystemFailure>([&] { MakeRobotSystem(PointMassTask(), options); }) ==
        "the robot's program gave no answer within 0.1 s");
}

}  // namespace
}  // namespace downpour
