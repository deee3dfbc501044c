// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/run_directory.h"

#include <doctest/doctest.h>

#include <nlohmann/json.hpp>

#include "engine/learner/atomic_file.h"
#include "engine/learner/checkpoint.h"
#include "engine/learner/saved_policy.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

Learner PointMassLearner() {
  return Learner(PointMassTask(), PointMassOptions(), PointMassState());
}

std::vector<std::string> Lines(const fs::path& file) {
  std::vector<std::string> lines;
  std::string text = ReadFile(file);
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    REQUIRE(end != std::string::npos);
    lines.push_back(text.substr(0, end));
    text.erase(0, end + 1);
  }
  return lines;
}

// Fields of a line; commas within quotes do not split.
int CountFields(const std::string& line) {
  int count = 1;
  bool quoted = false;
  for (const char c : line) {
    if (c == '"') quoted = !quoted;
    if (c == ',' && !quoted) ++count;
  }
  return count;
}

TEST_CASE("run directory: a new one is made with its parents and holds the configuration") {
  const TemporaryDirectory directory;
  const fs::path path = directory.path() / "a" / "b";
  RunDirectory::Create(path, "seed = 1\n");
  CHECK(RunDirectory::Open(path).ReadConfig() == "seed = 1\n");
  CHECK(SameBits(RunDirectory::Open(path).ReadState(PointMassTask(), PointMassOptions()),
                 LearnerState()));
}

TEST_CASE("run directory: an existing run is refused and left as it is") {
  const TemporaryDirectory directory;
  RunDirectory::Create(directory.path(), "old");
  CHECK(ErrorOf<InvalidInput>([&] { RunDirectory::Create(directory.path(), "new"); }) ==
        directory.path().string() + ": is not empty: use --resume " + directory.path().string() +
            " to go on with the run in it, or another --out");
  CHECK(RunDirectory::Open(directory.path()).ReadConfig() == "old");
  const fs::path file = directory.path() / "config.toml";
  CHECK(ErrorOf<InvalidInput>([&] { RunDirectory::Create(file, "new"); }) ==
        file.string() + ": is not a directory: use another --out");
  CHECK(ErrorOf<FileError>([&] { RunDirectory::Create(file / "below", ""); }) ==
        (file / "below").string() + ": cannot create: Not a directory");
}

TEST_CASE(
    "run directory: what a kill in the middle of making it leaves does not stand in the way") {
  const TemporaryDirectory directory;
  WriteFileAtomically(directory.path() / "config.toml.tmp", "see");
  CHECK_NOTHROW(RunDirectory::Create(directory.path(), "seed = 1\n"));
}

TEST_CASE("run directory: only a run can be opened") {
  const TemporaryDirectory directory;
  for (const fs::path& path : {directory.path(), directory.path() / "none"}) {
    CHECK(ErrorOf<InvalidInput>([&] { RunDirectory::Open(path); }) ==
          path.string() + ": no run here: must be a directory with a config.toml");
  }
}

TEST_CASE("run directory: the tables have a header with units and a row an episode or step") {
  const TemporaryDirectory directory;
  RunDirectory::Create(directory.path(), "").Write(PointMassLearner());
  const auto lines = [&](const char* name) { return Lines(directory.path() / name); };
  CHECK(lines("episodes.csv") ==
        std::vector<std::string>{
            "episode,random,interaction_seconds [s],points,evaluations [rollouts],gp_queries,"
            "diverged [rollouts],predicted_return,return,solved,steps,outcome",
            "1,true,0.5,0,0,0,0,,0,false,5,complete",
            "2,false,1,5,9007199254740992,9223372036854775807,3,"
            "1.3333333333333333,5e-324,true,3,\"aborted at step 3: \"\"x\"\", y\""});
  CHECK(lines("timing.csv") ==
        std::vector<std::string>{
            "episode,model_seconds [s],search_seconds [s],gp_queries_per_second [1/s],"
            "rollout_seconds [s],lane_fill,idle_share,rollout_time_per_gp_query "
            "[ns],gp_query_time.velocity "
            "[ns],"
            "\"gp_query_time.position, \"\"x\"\" [ns]\"",
            "1,0,0,,0,,,,,",
            "2,0.25,0.5,18446744073709551616,0.375,0.6666666666666666,0.3333333333333333,4."
            "0657581468206416e-11,0."
            "3333333333333333,0.1"});
  const std::vector<std::string> transitions = lines("transitions.csv");
  CHECK(transitions[0] ==
        "episode,step,time [s],observation.velocity [m/s],\"observation.position, \"\"x\"\" [m]\","
        "action.force [N],next_observation.velocity [m/s],"
        "\"next_observation.position, \"\"x\"\" [m]\",next_state.velocity [m/s],"
        "\"next_state.position, \"\"x\"\" [m]\",reward");
  CHECK(transitions.size() == 1 + 5 + 3);
  CHECK(transitions[6] ==
        "2,0,0,5e-324,-0,0.3333333333333333,1.0000000000000002,1e+308,0,-1e-300,0.1");
  for (const std::string& line : transitions) CHECK(CountFields(line) == 11);
  const std::vector<std::string> hyperparameters = lines("hyperparameters.csv");
  CHECK(hyperparameters.size() == 1 + 2 * 6);
  CHECK(hyperparameters[0] == "episode,output,hyperparameter,unit,value");
  CHECK(hyperparameters[3] == "2,velocity,lengthscale.force,N,0.7");
  CHECK(hyperparameters[5] == "2,velocity,noise_std,m/s,1e-05");
  CHECK(hyperparameters[6] == "2,velocity,jitter,1,0");
  const std::vector<std::string> plans = lines("plans.csv");
  CHECK(plans.size() == 1 + 2);
  CHECK(plans[1] == "2,velocity,blas,5,5,fp64,0,1,0,0,2");
  CHECK(plans[2] ==
        "2,\"position, \"\"x\"\"\",fused,5,3,fp32,0.003,0.3333333333333333,0.01,5e-324,2");
  CHECK(hyperparameters[12] == "2,\"position, \"\"x\"\"\",jitter,1,1e-10");
}

TEST_CASE("run directory: the state and the policy come back, and fit only their task") {
  const TemporaryDirectory directory;
  const RunDirectory run = RunDirectory::Create(directory.path(), "");
  run.Write(PointMassLearner());
  CHECK(SameBits(run.ReadState(PointMassTask(), PointMassOptions()), PointMassState()));
  CHECK(ReadFile(directory.path() / "policy.json") == ReadFile(directory.path() / "policy_2.json"));
  CHECK_FALSE(fs::exists(directory.path() / "policy_1.json"));
  const fs::path file = directory.path() / "policy.json";
  SavedPolicy policy = ReadPolicy(file);
  CHECK(policy.episode == 2);
  CHECK(SameBits(policy.parameters, PointMassState().episodes[1].policy));
  Task task = PointMassTask();
  CHECK(MakePolicy(policy, task)->n_parameters() == 5);
  policy.parameters.pop_back();
  CHECK(ErrorOf<InvalidInput>([&] { MakePolicy(policy, task); }) ==
        file.string() + ": policy of task point_mass: parameters has 4 entries: must be 5");
  task.action_limits = {3};
  CHECK(ErrorOf<InvalidInput>([&] { MakePolicy(policy, task); }) ==
        file.string() +
            ": policy of task point_mass, preset paper: action_limits differ from those of task "
            "point_mass, preset paper");
}

TEST_CASE("run directory: a random episode leaves no policy") {
  const TemporaryDirectory directory;
  LearnerState state = PointMassState();
  state.episodes.resize(1);
  state.transitions.resize(5);
  const RunDirectory run = RunDirectory::Create(directory.path(), "");
  run.Write(Learner(PointMassTask(), PointMassOptions(), state));
  CHECK(SameBits(run.ReadState(PointMassTask(), PointMassOptions()), state));
  CHECK_FALSE(fs::exists(directory.path() / "policy.json"));
  CHECK_FALSE(fs::exists(directory.path() / "policy_1.json"));
}

TEST_CASE("run directory: a policy file with a wrong field is refused") {
  const TemporaryDirectory directory;
  RunDirectory::Create(directory.path(), "").Write(PointMassLearner());
  const fs::path file = directory.path() / "policy.json";
  const std::string text = ReadFile(file);
  const auto error = [&](const char* key, const nlohmann::json& value) {
    nlohmann::json policy = nlohmann::json::parse(text);
    policy[nlohmann::json::json_pointer(key)] = value;
    WriteFileAtomically(file, policy.dump());
    return ErrorOf<InvalidInput>([&] { ReadPolicy(file); });
  };
  const std::string at = file.string() + ": ";
  CHECK(error("/kind", "gp") == at + "points is missing");
  CHECK(error("/parameters/2", "nan") == at + "parameters[2] = \"nan\": must be finite");
  CHECK(error("/parameters/4", "-inf") == at + "parameters[4] = \"-inf\": must be finite");
  CHECK(error("/input_scale/0", 0) == at + "input_scale[0] = 0: must be finite and > 0");
  CHECK(error("/input_scale/1", "nan") == at + "input_scale[1] = \"nan\": must be finite and > 0");
  CHECK(error("/action_limits/0", "inf") ==
        at + "action_limits[0] = \"inf\": must be finite and > 0");
}

TEST_CASE("run directory: one object at a time writes it, any number read it") {
  const TemporaryDirectory directory;
  const fs::path path = directory.path() / "run";
  const std::string refused =
      path.string() + ": another process is writing this run: wait for its end, or stop it";
  {
    const RunDirectory first = RunDirectory::Create(path, "seed = 1\n");
    CHECK(ErrorOf<InvalidInput>([&] { RunDirectory::OpenForWriting(path); }) == refused);
    CHECK(ErrorOf<InvalidInput>([&] { RunDirectory::Create(path, ""); }) == refused);
    CHECK(RunDirectory::Open(path).ReadConfig() == "seed = 1\n");
  }
  RunDirectory second = RunDirectory::OpenForWriting(path);
  const RunDirectory moved = std::move(second);
  CHECK(ErrorOf<InvalidInput>([&] { RunDirectory::OpenForWriting(path); }) == refused);
  moved.Write(PointMassLearner());
  CHECK(SameBits(RunDirectory::Open(path).ReadState(PointMassTask(), PointMassOptions()),
                 PointMassState()));
}

TEST_CASE("run directory: a full disk keeps the last checkpoint") {
  const TemporaryDirectory directory;
  const RunDirectory run = RunDirectory::Create(directory.path(), "");
  const Learner learner = PointMassLearner();
  run.Write(learner);
  const std::string before = ReadFile(directory.path() / "checkpoint.json");
  fs::create_symlink("/dev/full", directory.path() / "transitions.csv.tmp");
  CHECK(ErrorOf<FileError>([&] { run.Write(learner); }) ==
        (directory.path() / "transitions.csv").string() +
            ": cannot write: No space left on device");
  CHECK(ReadFile(directory.path() / "checkpoint.json") == before);
  run.Write(learner);
  CHECK(ReadFile(directory.path() / "checkpoint.json") == before);
}

}  // namespace
}  // namespace downpour
