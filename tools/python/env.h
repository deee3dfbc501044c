// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "tools/python/arguments.h"

namespace downpour::python {

void AddEnv(py::module_* module);

}  // namespace downpour::python
