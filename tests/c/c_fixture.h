// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <doctest/doctest.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "kernels/philox/philox.h"
#include "tools/c/downpour.h"

namespace downpour {

// n points of the pendulum's model, D = 4 (velocity, cos, sin, torque), E = 2.
struct CData {
  explicit CData(int n) : n(n), inputs(n * 4), targets(n * 2) {
    std::vector<double> u(n * 3);
    FillUniforms({3, 5}, 0, u.data(), u.size());
    for (int i = 0; i < n; ++i) {
      const double v = 4 * u[3 * i] - 2, angle = 6 * u[3 * i + 1], torque = 5 * u[3 * i + 2] - 2.5;
      const double row[] = {v, std::cos(angle), std::sin(angle), torque};
      std::copy(row, row + 4, &inputs[4 * i]);
      targets[2 * i] = 0.1 * (torque - 5 * std::sin(angle));
      targets[2 * i + 1] = 0.1 * v;
    }
  }
  int n;
  std::vector<double> inputs, targets;
  std::vector<double> lengthscales = {3, 1.5, 1.5, 4, 2, 2, 2, 2};
  std::vector<double> signal_std = {0.7, 0.5}, noise_std = {0.05, 0.02};
};

using CGp = std::unique_ptr<downpour_gp, decltype(&downpour_gp_destroy)>;
using CEvaluator = std::unique_ptr<downpour_evaluator, decltype(&downpour_evaluator_destroy)>;

inline CGp MakeCGp(const CData& d, const downpour_gp_options* options = nullptr) {
  downpour_gp* gp = nullptr;
  const int status =
      downpour_gp_create(d.inputs.data(), d.targets.data(), d.n, 4, 2, d.lengthscales.data(),
                         d.signal_std.data(), d.noise_std.data(), options, &gp);
  REQUIRE_MESSAGE(status == DOWNPOUR_OK, downpour_last_error());
  return {gp, &downpour_gp_destroy};
}

inline CEvaluator MakeCEvaluator(const downpour_gp* gp, const downpour_evaluator_options& options) {
  downpour_evaluator* evaluator = nullptr;
  const int status = downpour_evaluator_create(gp, &options, &evaluator);
  REQUIRE_MESSAGE(status == DOWNPOUR_OK, downpour_last_error());
  return {evaluator, &downpour_evaluator_destroy};
}

// The status is `status`, and the message holds `text`.
inline void CheckFailure(int status, int wanted, const char* text) {
  CAPTURE(std::string(downpour_last_error()));
  CHECK(status == wanted);
  CHECK(std::string(downpour_last_error()).find(text) != std::string::npos);
}

}  // namespace downpour
