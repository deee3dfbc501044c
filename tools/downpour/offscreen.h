// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "tasks/mujoco_system.h"

namespace downpour {

struct Image {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> rgb;  // (height x width x 3), the top row first
};

// Draws MuJoCo systems of one model, without a display: EGL on Mesa's surfaceless platform, so that
// a GPU is not needed either. The first fixed camera of the model looks on, else MuJoCo's own.
class Offscreen {
 public:
  // Throws FileError if the program was built without EGL or EGL gives no OpenGL here. `system`
  // must outlive it. Of one thread, one object at a time.
  Offscreen(MujocoSystem* system, int width, int height);
  ~Offscreen();

  // The system as it stands, and over it the moving bodies of `ghosts`, translucent.
  // A line of text each stands in the upper and in the lower left corner.
  Image Draw(std::span<const std::unique_ptr<MujocoSystem>> ghosts, const std::string& upper,
             const std::string& lower);

 private:
  struct Context;
  std::unique_ptr<Context> context_;
};

// How pictures are drawn, e.g. "EGL, llvmpipe ..."; throws as Offscreen.
std::string OffscreenDescription();

}  // namespace downpour
