// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "engine/gp/multi_output_gp.h"
#include "tools/python/arguments.h"

namespace downpour::python {

// downpour.GaussianProcess. Calls of its members hold the GIL.
struct GaussianProcess {
  std::shared_ptr<const MultiOutputGp> model;
  // Measured when the plan is first asked for.
  std::optional<std::vector<double>> query_nanoseconds;
};

void AddGaussianProcess(py::module_* module);

}  // namespace downpour::python
