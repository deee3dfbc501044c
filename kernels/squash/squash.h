// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace downpour {

// Squash clips its argument to +-this, within the range of the vector sine.
inline constexpr double kSquashLimit = 30000;

}  // namespace downpour
