// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/policy.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "tests/rollout/swing_fixture.h"

namespace downpour {
namespace {

const std::vector<PolicyOptions> kKinds = {
    {.hidden_units = {4}},
    {.hidden_units = {5, 3}, .activation = Activation::kRelu},
    {.kind = PolicyKind::kLinear},
    {.kind = PolicyKind::kGp, .points = 7},
    {.kind = PolicyKind::kDmp, .points = 5}};

Task TwoActions() {
  Task task = SwingTask(6);
  task.actions.push_back({"brake", "N m"});
  task.action_limits.push_back(0.5);
  return task;
}

TEST_CASE("policy: parameters are counted as documented") {
  const Task task = TwoActions();  // F = 3, A = 2
  const std::vector<int> want = {(3 + 1) * 4 + (4 + 1) * 2, (3 + 1) * 5 + (5 + 1) * 3 + (3 + 1) * 2,
                                 (3 + 1) * 2, 7 * 3 + 2 * (7 + 3), 2 * (5 + 1)};
  for (std::size_t k = 0; k < kKinds.size(); ++k) {
    CHECK(MakePolicy(task, kKinds[k])->n_parameters() == want[k]);
  }
  CHECK(MakePolicy(task, {.kind = PolicyKind::kGp})->n_parameters() == 10 * 3 + 2 * (10 + 3));
}

TEST_CASE("policy: one action is that of a lane, at every step") {
  const Task task = TwoActions();
  for (const PolicyOptions& options : kKinds) {
    const auto policy = MakePolicy(task, options);
    CAPTURE(policy->kind());
    const int n = policy->n_parameters();
    AlignedVector<double> parameters(n * kTileLanes), features(3 * kTileLanes);
    FillNormals({1, 1}, 0, parameters.data(), parameters.size());
    FillNormals({1, 2}, 0, features.data(), features.size());
    AlignedVector<double> scratch(policy->scratch_rows() * kTileLanes), actions(2 * kTileLanes);
    policy->PrepareTile(kTileLanes, parameters.data(), scratch.data());
    for (int step = 0; step < 8; ++step) {  // two of them beyond the horizon
      policy->ActTile(step, kTileLanes, parameters.data(), features.data(), scratch.data(),
                      actions.data());
      for (const int lane : {0, 5, kTileLanes - 1}) {
        std::vector<double> theta(n), x(3), u(2);
        for (int p = 0; p < n; ++p) theta[p] = parameters[p * kTileLanes + lane];
        for (int f = 0; f < 3; ++f) x[f] = features[f * kTileLanes + lane];
        policy->Act(step, theta, x, u);
        CHECK(u == std::vector<double>{actions[lane], actions[kTileLanes + lane]});
      }
    }
  }
}

TEST_CASE("policy: lanes in use have the same bits, however many there are") {
  const Task task = TwoActions();
  for (const PolicyOptions& options : kKinds) {
    const auto policy = MakePolicy(task, options);
    CAPTURE(policy->kind());
    AlignedVector<double> parameters(policy->n_parameters() * kTileLanes);
    AlignedVector<double> features(3 * kTileLanes);
    FillNormals({1, 1}, 0, parameters.data(), parameters.size());
    FillNormals({1, 2}, 0, features.data(), features.size());
    const auto act = [&](int n_lanes) {
      AlignedVector<double> scratch(policy->scratch_rows() * kTileLanes, std::nan(""));
      AlignedVector<double> actions(2 * kTileLanes, std::nan(""));
      policy->PrepareTile(n_lanes, parameters.data(), scratch.data());
      policy->ActTile(3, n_lanes, parameters.data(), features.data(), scratch.data(),
                      actions.data());
      return actions;
    };
    const AlignedVector<double> all = act(kTileLanes);
    for (const int n_lanes : {1, 7, 8, 9, 31, 33, kTileLanes - 1}) {
      CAPTURE(n_lanes);
      const AlignedVector<double> some = act(n_lanes);
      for (int action = 0; action < 2; ++action) {
        const auto row = some.begin() + action * kTileLanes;
        CHECK(std::equal(row, row + n_lanes, all.begin() + action * kTileLanes));
      }
      // Work is saved: half a tile's lanes do not touch the other half.
      if (n_lanes <= kTileLanes / 2) CHECK(std::isnan(some[kTileLanes - 1]));
    }
  }
}

TEST_CASE("policy: in the evaluator, bits depend neither on threads nor on packing") {
  for (const PolicyOptions& options : kKinds) {
    Fixture f(8);
    f.policy = MakePolicy(f.task, options);
    CAPTURE(f.policy->kind());
    const auto one = f.Returns(61, 2, {});
    CHECK(f.Returns(61, 2, {.threads = 3}) == one);
    const auto few = f.Returns(3, 2, {});
    CHECK(std::equal(few.begin(), few.end(), one.begin()));
    CHECK(*std::max_element(one.begin(), one.end()) > *std::min_element(one.begin(), one.end()));
  }
}

TEST_CASE("policy: rollouts that are packed anew half-way end with the same bits") {
  for (const PolicyOptions& options : kKinds) {
    Fixture f(8);
    f.policy = MakePolicy(f.task, options);
    CAPTURE(f.policy->kind());
    const int n = 61;
    const auto whole = f.Returns(n, 1, {});
    std::vector<double> theta(static_cast<std::size_t>(n) * f.policy->n_parameters());
    FillNormals({2, 2}, 0, theta.data(), theta.size());
    std::vector<StreamKey> keys;
    for (std::uint32_t c = 0; c < n; ++c) {
      keys.push_back(DeriveKey(7, StreamPurpose::kRollout, {c}));
    }
    Evaluator evaluator(f.task, *f.policy, f.factors, {});
    std::vector<double> returns(n);
    const CandidateGroup all{n, 5};
    evaluator.Evaluate(theta, keys, std::vector<int>(n, 1), std::vector<int>(n, 0), returns,
                       std::span(&all, 1));
    std::vector<double> best = whole;
    std::nth_element(best.begin(), best.begin() + 4, best.end(), std::greater<>());
    for (int c = 0; c < n; ++c) {
      if (whole[c] >= best[4]) CHECK(returns[c] == whole[c]);
    }
  }
}

TEST_CASE("policy: rollouts act as the policy does for one state and step") {
  for (const PolicyOptions& options : kKinds) {
    Fixture f(8);
    f.policy = MakePolicy(f.task, options);
    CAPTURE(f.policy->kind());
    Evaluator evaluator(f.task, *f.policy, f.factors, {});
    std::vector<double> theta(f.policy->n_parameters());
    FillNormals({1, 1}, 0, theta.data(), theta.size());
    const auto visited =
        evaluator.Trace(theta, std::vector<StreamKey>{{1, 1}}, std::vector<int>{1}).inputs;
    for (int step = 0; step < 8; ++step) {
      const double* x = &visited[step * 4];
      std::vector<double> u(1);
      f.policy->Act(step, theta, std::span(x, 3), u);
      CHECK(x[3] == u[0]);
      CHECK(u[0] != 0);
    }
  }
}

// A user's own: full torque one way or the other, by the sign of a linear function.
class BangBang final : public Policy {
 public:
  explicit BangBang(const Task& task) : limit_(task.action_limits[0]) {}
  std::string kind() const override { return "bang-bang"; }
  int n_parameters() const override { return 3; }
  void ActTile(int, int n_lanes, const double* parameters, const double* features, double*,
               double* actions) const override {
    for (int lane = 0; lane < n_lanes; ++lane) {
      double sum = 0;
      for (int f = 0; f < 3; ++f) {
        sum += parameters[f * kTileLanes + lane] * features[f * kTileLanes + lane];
      }
      actions[lane] = sum > 0 ? limit_ : -limit_;
    }
  }

 private:
  double limit_;
};

TEST_CASE("policy: a user's own class runs in the evaluator") {
  Fixture f(8);
  const PolicyOptions options = {
      .make = [](const Task& task) { return std::make_unique<BangBang>(task); }};
  f.policy = MakePolicy(f.task, options);
  CHECK(f.policy->kind() == "bang-bang");
  Evaluator evaluator(f.task, *f.policy, f.factors, {});
  const std::vector<double> theta = {1, 0.5, -2};
  const auto visited =
      evaluator.Trace(theta, std::vector<StreamKey>{{1, 1}}, std::vector<int>{1}).inputs;
  for (int step = 0; step < 8; ++step) {
    const double* x = &visited[step * 4];
    CHECK(x[3] == (x[0] + 0.5 * x[1] - 2 * x[2] > 0 ? 2.5 : -2.5));
  }
}

TEST_CASE("policy: options out of range are refused by name") {
  const Task task = SwingTask(6);
  const auto error = [&](const PolicyOptions& options) -> std::string {
    try {
      MakePolicy(task, options);
    } catch (const InvalidInput& e) {
      return e.what();
    }
    return "";
  };
  CHECK(error({.hidden_units = {}}) == "number of policy.hidden_units = 0: must be in [1, 8]");
  CHECK(error({.hidden_units = std::vector<int>(9, 2)}) ==
        "number of policy.hidden_units = 9: must be in [1, 8]");
  CHECK(error({.hidden_units = {4, 0}}) == "policy.hidden_units = 0: must be in [1, 256]");
  CHECK(error({.kind = PolicyKind::kGp, .points = 201}) ==
        "policy.points = 201: must be in [0, 200]");
  CHECK(error({.kind = PolicyKind::kDmp, .points = -1}) ==
        "policy.points = -1: must be in [0, 200]");
  CHECK(error({.make = [](const Task&) { return nullptr; }}) ==
        "policy.make gave no policy: must be one with a parameter at least");
}

}  // namespace
}  // namespace downpour
