// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "engine/rollout/block_functions.h"
#include "engine/rollout/task.h"
#include "tools/python/arguments.h"

namespace downpour::python {

// Python's callables; None: none.
struct BlockCallables {
  py::object features, policy, reward;
};

// As functions for one evaluation of a task of these sizes. They take the GIL for each call. The
// arrays that callables get are their own copies, column-major (Fortran order), but that of the
// parameters is made once and read-only. Callables raise what they raise; for a result of another
// shape or dtype, TypeError or ValueError that names the callable. To be called, copied and
// destroyed with the GIL, as BlockCallables.
BlockFunctions MakeBlockFunctions(const BlockCallables& callables, const Task& task,
                                  py::ssize_t n_parameters);

}  // namespace downpour::python
