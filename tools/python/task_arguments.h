// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "engine/gp/multi_output_gp.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/task.h"
#include "tools/python/arguments.h"

namespace downpour::python {

std::string ToText(py::handle value, const char* name);

// A task of a user's own for `model`: E states, and features by a list as Evaluator's docstring has
// it, or None: the states; or, if they come from a callable, as many as the actions leave. No
// reward, simulator or limits.
Task CustomTask(const MultiOutputGp& model, const py::object& features, py::handle action_limit,
                bool own_features);

// Overrides what is not None.
void SetTask(py::handle horizon, py::handle start, py::handle start_std, py::handle action_limit,
             Task* task);

PolicyOptions ToPolicyOptions(py::handle policy, py::handle hidden_units, py::handle activation,
                              py::handle points);

}  // namespace downpour::python
