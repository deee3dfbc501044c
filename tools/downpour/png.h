// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "tools/downpour/offscreen.h"

namespace downpour {

// The bytes of a PNG file. Throws FileError.
std::string EncodePng(const Image& image);

}  // namespace downpour
