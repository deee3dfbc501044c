// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace downpour {

// The processor's name; "unknown" where the system does not tell it.
std::string CpuModel();

}  // namespace downpour
