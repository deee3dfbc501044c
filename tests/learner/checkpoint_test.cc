// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/checkpoint.h"

#include <doctest/doctest.h>

#include <cstdint>
#include <nlohmann/json.hpp>

#include "engine/learner/platform.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

using Json = nlohmann::json;

LearnerState Parse(const std::string& text) {
  return ParseCheckpoint(PointMassTask(), PointMassOptions(), text, "run/checkpoint.json");
}

std::string ParseError(const std::string& text) {
  return ErrorOf<InvalidInput>([&] { Parse(text); });
}

std::string Text() {
  return FormatCheckpoint(PointMassTask(), PointMassOptions(), PointMassState());
}

// A checkpoint whose payload was changed by hand, with the checksum made right again (64-bit
// FNV-1a, written out once more here).
std::string TextWith(const std::function<void(Json&)>& change) {
  Json json = Json::parse(Text());
  change(json["payload"]);
  std::uint64_t hash = 14695981039346656037u;
  for (const unsigned char c : json["payload"].dump()) hash = (hash ^ c) * 1099511628211u;
  char digits[17];
  std::snprintf(digits, sizeof(digits), "%016llx", static_cast<unsigned long long>(hash));
  json["checksum"] = digits;
  return json.dump();
}

TEST_CASE("checkpoint: every number comes back with the same bits, NaN and denormals too") {
  const LearnerState state = PointMassState();
  const LearnerState read = Parse(Text());
  CHECK(SameBits(read, state));
  CHECK(read.episodes[1].model_seconds == state.episodes[1].model_seconds);
  CHECK(read.episodes[1].search_seconds == state.episodes[1].search_seconds);
  CHECK(read.episodes[1].rollout_seconds == state.episodes[1].rollout_seconds);
  CHECK(read.episodes[1].lane_fill == state.episodes[1].lane_fill);
  CHECK(read.episodes[1].idle_share == state.episodes[1].idle_share);
  CHECK(std::isnan(read.episodes[0].idle_share));
  CHECK(SameBits(read.episodes[1].query_nanoseconds, state.episodes[1].query_nanoseconds));
  CHECK(SameBits(Parse(TextWith([](Json&) {})), state));
}

TEST_CASE("checkpoint: a state without episodes round-trips through a file") {
  const TemporaryDirectory directory;
  const std::filesystem::path file = directory.path() / "checkpoint.json";
  WriteCheckpoint(file, PointMassTask(), PointMassOptions(), {});
  CHECK(SameBits(ReadCheckpoint(file, PointMassTask(), PointMassOptions()), LearnerState()));
}

TEST_CASE("checkpoint: a truncated file is refused at every length") {
  const std::string text = Text();
  for (std::size_t part = 0; part < 20; ++part) {
    const std::string error = ParseError(text.substr(0, text.size() * part / 20));
    CHECK(Contains(error, "run/checkpoint.json: truncated at byte "));
  }
}

TEST_CASE("checkpoint: no flipped byte goes unnoticed") {
  const LearnerState state = PointMassState();
  const std::string text = Text();
  int refused = 0;
  for (std::size_t i = 0; i + 1 < text.size(); ++i) {
    for (const char mask : {1, 16}) {
      std::string flipped = text;
      flipped[i] = static_cast<char>(flipped[i] ^ mask);
      std::string error;
      LearnerState read;
      CHECK_NOTHROW(error = ErrorOf<InvalidInput>([&] { read = Parse(flipped); }));
      if (!error.empty()) {
        ++refused;
        CHECK(error.rfind("run/checkpoint.json: ", 0) == 0);
        CHECK_FALSE(Contains(error, "\n"));
      } else {
        // A last digit that stands for the same double changes nothing.
        CHECK(SameBits(read, state));
      }
    }
  }
  CHECK(refused > 0.99 * 2 * (text.size() - 1));
}

TEST_CASE("checkpoint: a later version is refused by its number") {
  std::string text = Text();
  const std::string own = std::to_string(kCheckpointVersion);
  const std::string later = std::to_string(kCheckpointVersion + 1);
  const std::string field = "\"version\":" + own;
  const std::size_t at = text.find(field);
  REQUIRE(at != std::string::npos);
  text.replace(at, field.size(), "\"version\":" + later);
  CHECK(ParseError(text) ==
        "run/checkpoint.json: version " + later + ", this program reads " + own);
}

TEST_CASE("checkpoint: another file is refused") {
  CHECK(ParseError("[1, 2]") == "run/checkpoint.json: the file = [1,2]: must be an object");
  CHECK(ParseError("{\"format\": \"x\"}") ==
        "run/checkpoint.json: format = \"x\": must be \"downpour checkpoint\"");
  CHECK(ParseError("{}") == "run/checkpoint.json: format is missing");
  CHECK(ParseError("[1e999]") ==
        "run/checkpoint.json: a number is beyond the range of a double: must be finite");
}

TEST_CASE("checkpoint: missing fields and wrong types are named") {
  const auto error = [](const char* pointer, const Json& value) {
    return ParseError(TextWith([&](Json& p) { p[Json::json_pointer(pointer)] = value; }));
  };
  const std::string at = "run/checkpoint.json: payload.";
  CHECK(error("/episodes", 3) == at + "episodes = 3: must be an array");
  CHECK(error("/episodes/1/solved", 1) == at + "episodes[1].solved = 1: must be true or false");
  CHECK(error("/episodes/1/policy/2", "x") ==
        at + "episodes[1].policy[2] = \"x\": must be a number");
  CHECK(error("/episodes/1/runs/0/stop", nullptr) ==
        at + "episodes[1].runs[0].stop = null: must be a string");
  CHECK(error("/episodes/1/gp_queries", UINT64_MAX) ==
        at + "episodes[1].gp_queries = 18446744073709551615: must be an integer in [0, "
             "9223372036854775807]");
  CHECK(error("/transitions/3/step", -1) ==
        at + "transitions[3].step = -1: must be an integer in [0, 2147483647]");
  CHECK(error("/transitions/3/step", 2147483648) ==
        at + "transitions[3].step = 2147483648: must be an integer in [0, 2147483647]");
  CHECK(error("/transitions/3/step", 1.5) ==
        at + "transitions[3].step = 1.5: must be an integer in [0, 2147483647]");
  CHECK(ParseError(TextWith([](Json& p) { p["transitions"][4].erase("reward"); })) ==
        at + "transitions[4].reward is missing");
}

TEST_CASE("checkpoint: wrong sizes and impossible values are named") {
  const auto error = [](const char* pointer, const Json& value) {
    return ParseError(TextWith([&](Json& p) { p[Json::json_pointer(pointer)] = value; }));
  };
  const std::string at = "run/checkpoint.json: ";
  CHECK(error("/transitions/7/observation", {1, 2, 3}) ==
        at + "transitions[7].observation has 3 entries: must be 2");
  CHECK(error("/episodes/1/policy", {1}) == at + "episodes[1].policy has 1 entries: must be 5");
  CHECK(error("/episodes/1/hyperparameters", Json::array()) ==
        at + "episodes[1].hyperparameters has 0 entries: must be 2");
  CHECK(error("/episodes/1/hyperparameters/0/lengthscales/1", 0.0) ==
        at + "episodes[1].hyperparameters[0].lengthscales[1] = 0: must be finite and > 0");
  CHECK(error("/transitions/0/reward", "nan") ==
        at + "transitions[0].reward = nan: must be finite");
  CHECK(error("/episodes/1/plans/1/points", 0) ==
        at + "payload.episodes[1].plans[1].points = 0: must be an integer in [1, 2147483647]");
  CHECK(error("/episodes/1/plans/1/backend", "cuda") ==
        at + "payload.episodes[1].plans[1].backend = \"cuda\": must be one of fused, blas");
  CHECK(error("/episodes/1/jitter", {0}) == at + "episodes[1].jitter has 1 entries: must be 2");
  CHECK(error("/episodes/1/episode", 3) == at + "episodes[1].episode = 3: must be 2");
  CHECK(error("/transitions/6/step", 4) == at + "transitions[6].step = 4: must be 1");
  CHECK(ParseError(TextWith([](Json& p) { p["transitions"].erase(7); })) ==
        at + "transitions has 7 entries: must be 8");
  CHECK(error("/episodes/0/outcome", "over") ==
        at + "episodes[0].outcome = \"over\": must be complete, done or aborted ...");
  CHECK(error("/episodes/0/steps", 4) == at + "episodes[0].steps = 4: must be in [5, 5]");
  CHECK(error("/episodes/1/steps", 5) == at + "episodes[1].steps = 5: must be in [1, 4]");
  CHECK(error("/episodes/1/steps", 2) == at + "transitions has 8 entries: must be 7");
}

TEST_CASE("checkpoint: settings that results depend on must be the run's own") {
  const auto error = [](const std::function<void(Task&, LearnerOptions&)>& change) {
    Task task = PointMassTask();
    LearnerOptions options = PointMassOptions();
    change(task, options);
    return ErrorOf<InvalidInput>([&] { ParseCheckpoint(task, options, Text(), "c.json"); });
  };
  CHECK(error([](Task&, LearnerOptions& o) { o.seed = 7; }) ==
        "c.json: the run was made with learn.seed = 18446744073709551615, the configuration says "
        "7: must "
        "be equal to resume");
  CHECK(Contains(error([](Task&, LearnerOptions& o) { o.search.evaluations = 1000; }),
                 "search.evaluations = 5000, the configuration says 1000"));
  CHECK(
      Contains(error([](Task&, LearnerOptions& o) { o.search.restarts = RestartStrategy::kSmall; }),
               "search.restarts = \"bipop\", the configuration says \"small\""));
  CHECK(Contains(error([](Task&, LearnerOptions& o) { o.plan.backend = QueryBackend::kBlas; }),
                 "model.backend = \"fused\", the configuration says \"blas\""));
  CHECK(Contains(error([](Task& t, LearnerOptions&) { t.preset = "original-code"; }),
                 "preset = \"paper\""));
  CHECK(Contains(error([](Task& t, LearnerOptions&) {
                   t.reward = MakeSaturatingReward(t.feature_names, {0, 1}, {1}, 0.25);
                 }),
                 "task.reward = \"exp(-d^2 / (2 x 0.5^2)), d^2 = (position"));
  CHECK(Contains(error([](Task&, LearnerOptions& o) { o.learn_reward = true; }),
                 "learn.learn_reward = false, the configuration says true"));
  CHECK(error([](Task& t, LearnerOptions&) { t.model_digest = "other"; }) ==
        "c.json: the run was made with task.model_digest = \"one\", the configuration says "
        "\"other\": must be equal to resume");
  // A run may go on for longer and on other threads.
  CHECK(error([](Task&, LearnerOptions& o) {
          o.episodes = 40;
          o.until_solved = true;
          o.threads = 3;
        }) == "");
}

TEST_CASE("platform: the first episode of another SIMD target or OpenBLAS kernel is named") {
  LearnerState state = Parse(Text());
  const std::string start =
      "results will not be bit-identical to those of an uninterrupted run, because episode ";
  CHECK(
      PlatformDifference(state, {"AVX3", "SkylakeX"}) ==
      start +
          "2 was made with SIMD target AVX2, now AVX3 and OpenBLAS kernels Haswell, now SkylakeX");
  CHECK(PlatformDifference(state, {"AVX2", "SkylakeX"}) ==
        start + "1 was made with SIMD target AVX3, now AVX2");
  state.episodes[1].platform = {"AVX3", "SkylakeX"};
  CHECK(PlatformDifference(state, {"AVX3", "SkylakeX"}) == "");
  CHECK(PlatformDifference(state, {"AVX3", "Haswell"}) ==
        start + "1 was made with OpenBLAS kernels SkylakeX, now Haswell");
  CHECK(PlatformDifference({}, {"AVX3", "SkylakeX"}) == "");
}

}  // namespace
}  // namespace downpour
