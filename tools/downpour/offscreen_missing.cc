// SPDX-License-Identifier: Apache-2.0
// Stands in for offscreen.cc where EGL was not there to build with.
#include "engine/errors.h"
#include "tools/downpour/offscreen.h"

namespace downpour {

struct Offscreen::Context {};

std::string OffscreenDescription() {
  throw FileError("built without EGL: run tools/setup --pictures");
}

Offscreen::Offscreen(MujocoSystem*, int, int) { OffscreenDescription(); }
Offscreen::~Offscreen() = default;

Image Offscreen::Draw(std::span<const std::unique_ptr<MujocoSystem>>, const std::string&,
                      const std::string&) {
  return {};
}

}  // namespace downpour
