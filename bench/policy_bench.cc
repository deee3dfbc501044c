// SPDX-License-Identifier: Apache-2.0

// What a policy costs in rollouts: nanoseconds a lane of one step, and of the preparation once a
// rollout, on one thread, full tiles, random parameters and features. Repetitions of all policies
// alternate, the best counts.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "bench/program.h"
#include "engine/rollout/policy.h"
#include "kernels/fma_peak/fma_peak.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

constexpr int kRepetitions = 15;

Task TaskOf(int n_features, int n_actions) {
  Task task;
  task.features.resize(n_features);
  task.actions.resize(n_actions);
  task.action_limits.assign(n_actions, 2.0);
  task.policy_input_scale.assign(n_features, 3.0);
  return task;
}

// One policy with its tile.
class Case {
 public:
  Case(std::string name, const Task& task, const PolicyOptions& options)
      : name_(std::move(name)), policy_(MakePolicy(task, options)) {
    parameters_.resize(static_cast<std::size_t>(policy_->n_parameters()) * kTileLanes);
    features_.resize(task.features.size() * kTileLanes);
    scratch_.resize(static_cast<std::size_t>(policy_->scratch_rows()) * kTileLanes);
    actions_.resize(task.actions.size() * kTileLanes);
    FillNormals({1, 1}, 0, parameters_.data(), parameters_.size());
    FillNormals({1, 2}, 0, features_.data(), features_.size());
  }

  void Repeat() {
    prepare_ = std::min(prepare_, Nanoseconds(50, [this](int) {
                          policy_->PrepareTile(kTileLanes, parameters_.data(), scratch_.data());
                        }));
    step_ = std::min(step_, Nanoseconds(2000, [this](int step) {
                       policy_->ActTile(step % 40, kTileLanes, parameters_.data(), features_.data(),
                                        scratch_.data(), actions_.data());
                     }));
  }

  void Print() const {
    std::printf("%-26s %5d %12.2f %14.1f\n", name_.c_str(), policy_->n_parameters(), step_,
                prepare_);
  }

 private:
  template <typename Call>
  static double Nanoseconds(int calls, const Call& call) {
    using Clock = std::chrono::steady_clock;
    const Clock::time_point start = Clock::now();
    for (int i = 0; i < calls; ++i) call(i);
    const std::chrono::duration<double, std::nano> elapsed = Clock::now() - start;
    return elapsed.count() / calls / kTileLanes;
  }

  std::string name_;
  std::unique_ptr<Policy> policy_;
  AlignedVector<double> parameters_, features_, scratch_, actions_;
  double prepare_ = std::numeric_limits<double>::infinity();
  double step_ = std::numeric_limits<double>::infinity();
};

int Main(int, char**) {
  const std::vector<std::pair<const char*, PolicyOptions>> kinds = {
      {"nn 10", {}},
      {"nn 16,16", {.hidden_units = {16, 16}}},
      {"nn 16,16 relu", {.hidden_units = {16, 16}, .activation = Activation::kRelu}},
      {"linear", {.kind = PolicyKind::kLinear}},
      {"gp 10", {.kind = PolicyKind::kGp, .points = 10}},
      {"gp 20", {.kind = PolicyKind::kGp, .points = 20}},
      {"gp 50", {.kind = PolicyKind::kGp, .points = 50}},
      {"dmp 20", {.kind = PolicyKind::kDmp, .points = 20}}};
  std::vector<Case> cases;
  for (const auto& [n_features, n_actions] : {std::pair{3, 1}, std::pair{5, 1}, std::pair{8, 4}}) {
    for (const auto& [name, options] : kinds) {
      cases.emplace_back(name + std::string(", F = ") + std::to_string(n_features) +
                             ", A = " + std::to_string(n_actions),
                         TaskOf(n_features, n_actions), options);
    }
  }
  for (int repetition = 0; repetition < kRepetitions; ++repetition) {
    for (Case& each : cases) each.Repeat();
  }
  std::printf("SIMD target %s\n%-26s %5s %12s %14s\n", SimdTargetName(), "policy", "P", "ns a step",
              "ns to prepare");
  for (const Case& each : cases) each.Print();
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("policy_bench", downpour::Main, argc, argv);
}
