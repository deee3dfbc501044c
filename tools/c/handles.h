// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "engine/gp/multi_output_gp.h"
#include "tools/c/downpour.h"

// What the opaque handles are, where more than one file sees them.

struct downpour_gp {
  std::shared_ptr<const downpour::MultiOutputGp> model;
};
