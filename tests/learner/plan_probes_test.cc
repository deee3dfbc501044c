// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/plan_probes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "engine/gp/gp_model.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

constexpr StreamKey kKey{7, 8};

TEST_CASE("plan_probes: random policies spread over the decades of the restarts' step sizes") {
  PolicySearchOptions search;
  search.restart_sigma = 5;
  search.restart_decades = 1.3;
  search.bound = 2;
  int small = 0, at_bound = 0;
  for (std::uint32_t c = 0; c < 400; ++c) {
    std::vector<double> parameters(50);
    DrawRandomPolicy(search, {c, 1}, parameters);
    const auto [least, most] = std::minmax_element(parameters.begin(), parameters.end());
    CHECK(*least >= -2);
    CHECK(*most <= 2);
    small += *most < 5 * std::pow(10, -0.65);
    at_bound += *most == 2;
  }
  // Half of the draws of U are above 1/2; sigma > 2 for U < log10(2.5)/1.3 = 0.306. 5 std of a
  // binomial count.
  CHECK(std::abs(small - 200) <= 50);
  CHECK(std::abs(at_bound - 122) <= 46);
}

TEST_CASE("plan_probes: policies around one differ from it by first_sigma, within the bound") {
  PolicySearchOptions search;
  search.first_sigma = 0.5;
  search.bound = 5;
  const std::vector<double> policy(4000, 1.0);
  std::vector<double> moved = policy;
  PerturbPolicy(search, kKey, moved);
  double squares = 0;
  for (const double value : moved) squares += (value - 1) * (value - 1);
  // The sum of squares has a relative std of sqrt(2 / 4000).
  CHECK(std::abs(squares / 4000 / 0.25 - 1) <= 5 * std::sqrt(2.0 / 4000));
  search.bound = 1.2;
  moved = policy;
  PerturbPolicy(search, kKey, moved);
  CHECK(*std::max_element(moved.begin(), moved.end()) == 1.2);
  CHECK(*std::min_element(moved.begin(), moved.end()) >= -1.2);
}

TEST_CASE("plan_probes: thirds by the last policy, by policies around it and by random ones") {
  const Task task = PointMassTask();
  const auto policy = MakePolicy(task, {.hidden_units = {1}});
  // A model of one point that predicts next to nothing.
  const ExactGp gp(Eigen::MatrixXd::Zero(1, 3), Eigen::VectorXd::Zero(1), {{1, 1, 1}, 0.1, 0.1});
  const std::vector<QueryFactor> factors(2, gp.Pack());
  Evaluator evaluator(task, *policy, factors, {});
  PolicySearchOptions search;
  search.first_sigma = 1e-6;
  // u = 2 tanh(b1): the same action always.
  const std::vector<double> last = {0, 0, 0, 0, 0.3};
  const Eigen::MatrixXd inputs = ProbeInputs(search, last, 3, 4, task.n_inputs(), &evaluator);
  REQUIRE(inputs.rows() == 96 * task.horizon);
  REQUIRE(inputs.cols() == 3);
  CHECK(inputs.allFinite());
  const Eigen::ArrayXd distance = (inputs.col(2).array() - 2 * std::tanh(0.3)).abs();
  CHECK((distance <= 1e-12).count() == 32 * task.horizon);
  CHECK((distance <= 1e-4).count() == 64 * task.horizon);
  CHECK(inputs == ProbeInputs(search, last, 3, 4, task.n_inputs(), &evaluator));
  CHECK(inputs != ProbeInputs(search, last, 3, 5, task.n_inputs(), &evaluator));
}

}  // namespace
}  // namespace downpour
