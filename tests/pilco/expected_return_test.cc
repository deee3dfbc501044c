// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/expected_return.h"

#include <doctest/doctest.h>

#include "tests/pilco/pilco_fixture.h"

namespace downpour {
namespace {

TEST_CASE("expected return: the gradient is that of central differences, every parameter") {
  for (const PolicyKind kind : {PolicyKind::kGp, PolicyKind::kLinear}) {
    const Task task = SwingTask(5);
    ExpectedReturn expected(task, {.kind = kind, .points = 4}, SwingModel(30), 1);
    const std::vector<double> theta = RandomNumbers(expected.n_parameters(), 3);
    std::vector<double> gradient(theta.size());
    expected.Evaluate(theta, gradient);
    CheckGradient(gradient, theta,
                  [&](const std::vector<double>& x) { return expected.Evaluate(x, {}); });
  }
}

}  // namespace
}  // namespace downpour
