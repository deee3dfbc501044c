// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/saved_policy.h"

#include <doctest/doctest.h>

#include <nlohmann/json.hpp>

#include "engine/learner/atomic_file.h"
#include "engine/learner/c_header.h"
#include "engine/learner/checkpoint.h"
#include "engine/learner/run_directory.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

const std::vector<PolicyOptions> kKinds = {
    {.hidden_units = {3}},
    {.hidden_units = {4, 2}, .activation = Activation::kRelu},
    {.kind = PolicyKind::kLinear},
    {.kind = PolicyKind::kGp, .points = 3},
    {.kind = PolicyKind::kDmp}};

Task AngleTask() {
  Task task = PointMassTask();
  task.features = {{FeatureKind::kIdentity, 0}, {FeatureKind::kCosine, 1}, {FeatureKind::kSine, 1}};
  task.feature_names = {{"v", "m/s"}, {"c", "1"}, {"s", "1"}};
  task.policy_input_scale = {3, 1, 1};
  return task;
}

// A policy of AngleTask with parameters that text formats lose.
SavedPolicy Sample(const PolicyOptions& options) {
  const Task task = AngleTask();
  LearnerOptions learner;
  learner.policy = options;
  const auto policy = MakePolicy(task, options);
  EpisodeRecord record;
  record.episode = 2;
  for (int p = 0; p < policy->n_parameters(); ++p) record.policy.push_back(1.0 / (3 + p) - 0.1);
  return MakeSavedPolicy(task, learner, *policy, record);
}

SavedPolicy FromText(const std::string& text) {
  const TemporaryDirectory directory;
  WriteFileAtomically(directory.path() / "policy.json", text);
  SavedPolicy policy = ReadPolicy(directory.path() / "policy.json");
  policy.file.clear();
  return policy;
}

TEST_CASE("saved policy: the file alone runs every kind with the same bits") {
  for (const PolicyOptions& options : kKinds) {
    const auto original = MakePolicy(AngleTask(), options);
    CAPTURE(original->kind());
    const SavedPolicy saved = Sample(options);
    const SavedPolicy read = FromText(FormatPolicy(saved));
    CHECK(FormatPolicy(read) == FormatPolicy(saved));
    const Task task = PolicyTask(read);
    const auto policy = MakePolicy(read, task);
    for (int step = 0; step < 4; ++step) {
      const std::vector<double> state = {0.3 * step, 1.0 - step};
      std::vector<double> features(3), wanted_features(3), action(1), wanted(1);
      ComputeFeatures(task, state, features);
      ComputeFeatures(AngleTask(), state, wanted_features);
      CHECK(features == wanted_features);
      policy->Act(step, read.parameters, features, action);
      original->Act(step, saved.parameters, features, wanted);
      CHECK(action == wanted);
    }
    CHECK_NOTHROW(MakePolicy(read, AngleTask()));
  }
}

TEST_CASE("saved policy: a file of one hidden layer from before other kinds is read") {
  const SavedPolicy saved = Sample({.hidden_units = {3}});
  Json json = Json::parse(FormatPolicy(saved));
  for (const char* key : {"activation", "states", "feature_map", "control_period", "horizon"}) {
    json.erase(key);
  }
  json["hidden_units"] = 3;
  const SavedPolicy read = FromText(json.dump());
  CHECK(read.states.empty());
  CHECK(read.hidden_units == std::vector<int>{3});
  CHECK(read.activation == Activation::kTanh);
  CHECK(MakePolicy(read, AngleTask())->n_parameters() == 16);
}

TEST_CASE("saved policy: what does not fit is named") {
  const auto error = [](const PolicyOptions& options, const char* pointer, const Json& value) {
    Json json = Json::parse(FormatPolicy(Sample(options)));
    json[Json::json_pointer(pointer)] = value;
    return ErrorOf<InvalidInput>([&] {
      const SavedPolicy read = FromText(json.dump());
      MakePolicy(read, AngleTask());
    });
  };
  const PolicyOptions nn = kKinds[0], gp = kKinds[3], dmp = kKinds[4];
  CHECK(Contains(error(nn, "/hidden_units/0", 0),
                 "hidden_units[0] = 0: must be an integer in [1, 256]"));
  CHECK(Contains(error(nn, "/hidden_units", Json::array()),
                 "number of policy.hidden_units = 0: must be in [1, 8]"));
  CHECK(Contains(error(nn, "/activation", "step"), "activation = \"step\": must be one of tanh, "));
  CHECK(Contains(error(gp, "/points", 201), "points = 201: must be an integer in [1, 200]"));
  CHECK(Contains(error(gp, "/points", 4), "parameters has 15 entries: must be 19"));
  CHECK(Contains(error(gp, "/feature_map/1/function", "tan"),
                 "feature_map[1].function = \"tan\": must be one of identity, cosine, sine"));
  CHECK(Contains(error(gp, "/feature_map/1/function", "sine"), "feature_map differ from those of"));
  CHECK(Contains(error(gp, "/feature_map/2/state", 2),
                 "feature_map[2].state = 2: must be an integer in [0, 1]"));
  CHECK(Contains(error(gp, "/states", Json::array()), "states = []: must be at least one name"));
  CHECK(Contains(error(gp, "/input_scale", {1, 2}), "input_scale = [1,2]: must be an array of 3"));
  CHECK(Contains(error(gp, "/horizon", 0), "horizon = 0: must be an integer in [1, 1000000]"));
  CHECK(Contains(error(gp, "/control_period", 0), "control_period = 0: must be finite and > 0"));
  CHECK(error(gp, "/horizon", 7).empty());
  CHECK(Contains(error(dmp, "/horizon", 7), "horizon differ from those of"));
  CHECK(Contains(error(nn, "/kind", "mine"),
                 "kind = \"mine\": must be one of nn, linear, gp, dmp; another is a user's own"));
}

// A user's own policy, for the learner: a force from a table of two, by the sign of the position.
class TwoForces final : public Policy {
 public:
  std::string kind() const override { return "two-forces"; }
  int n_parameters() const override { return 2; }
  void ActTile(int, int n_lanes, const double* parameters, const double* features, double*,
               double* actions) const override {
    for (int lane = 0; lane < n_lanes; ++lane) {
      const int row = features[kTileLanes + lane] > 0 ? 1 : 0;
      actions[lane] = 0.4 * parameters[row * kTileLanes + lane];  // bound 5, limit 2
    }
  }
};

LearnerOptions OwnPolicyOptions() {
  LearnerOptions options = TinyOptions();
  options.episodes = 3;
  options.seed = 0;
  options.policy.make = [](const Task&) { return std::make_unique<TwoForces>(); };
  return options;
}

TEST_CASE("learner: a user's own policy is learnt, saved and resumed") {
  const TemporaryDirectory directory;
  const Task task = PointMassTask();
  const LearnerOptions options = OwnPolicyOptions();
  const RunDirectory run = RunDirectory::Create(directory.path() / "run", "");
  Learner learner(task, options);
  while (!learner.done()) learner.RunEpisode({});
  run.Write(learner);
  CHECK(learner.policy().kind() == "two-forces");
  CHECK(learner.state().episodes.back().policy.size() == 2);
  CHECK(SameBits(run.ReadState(task, options), learner.state()));
  LearnerOptions built_in = options;
  built_in.policy.make = nullptr;
  CHECK(ErrorOf<InvalidInput>([&] { run.ReadState(task, built_in); }) ==
        (run.path() / "checkpoint.json").string() +
            ": the run was made with policy.kind = \"two-forces\", the configuration says \"nn\": "
            "must be equal to resume");
  const SavedPolicy saved = ReadPolicy(run.path() / "policy.json");
  CHECK(SameBits(saved.parameters, learner.state().episodes.back().policy));
}

TEST_CASE("learner: every kind of policy is resumed only with its own settings") {
  const Task task = PointMassTask();
  for (const PolicyOptions& kind : kKinds) {
    LearnerOptions options = OwnPolicyOptions();
    options.policy = kind;
    Learner learner(task, options);
    while (!learner.done()) learner.RunEpisode({});
    const std::string text = FormatCheckpoint(task, options, learner.state());
    CHECK(SameBits(ParseCheckpoint(task, options, text, "c"), learner.state()));
    LearnerOptions other = options;
    other.policy.activation = static_cast<Activation>(1 - static_cast<int>(kind.activation));
    CHECK(Contains(ErrorOf<InvalidInput>([&] { ParseCheckpoint(task, other, text, "c"); }),
                   "policy.activation"));
    other = options;
    other.policy.points = kind.points + 1;
    CHECK(Contains(ErrorOf<InvalidInput>([&] { ParseCheckpoint(task, other, text, "c"); }),
                   "policy.points"));
    other = options;
    other.policy.hidden_units.push_back(2);
    CHECK(Contains(ErrorOf<InvalidInput>([&] { ParseCheckpoint(task, other, text, "c"); }),
                   "policy.hidden_units"));
  }
}

TEST_CASE("c header: names from a file cannot leave the comment") {
  SavedPolicy saved = Sample(kKinds[2]);
  saved.states[0] = "a*/ int x; /*\n\\";
  const std::string text = CHeader(saved, PolicyTask(saved));
  CHECK(Contains(text, "state: a__ int x_ ____, position"));
  CHECK(text.find("*/") == text.rfind("*/"));
}

}  // namespace
}  // namespace downpour
