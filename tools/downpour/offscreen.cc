// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/offscreen.h"

// EGL's header would bring X11's, whose macros are everywhere.
#define EGL_NO_X11
#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <fmt/format.h>
#include <mujoco/mujoco.h>

#include <algorithm>

#include "engine/errors.h"

namespace downpour {
namespace {

constexpr int kMaxGeoms = 2000;
constexpr float kGhostColour[4] = {0.16f, 0.47f, 0.84f, 0.3f};
// So that what goes as expected is hidden by the real body instead of flickering through it.
constexpr float kGhostSize = 0.9f;
constexpr float kInk[3] = {0.13f, 0.19f, 0.24f};

// Letters that stay legible when a picture of this width is shown at half its size.
int FontScale(int width) { return width >= 1280 ? mjFONTSCALE_250 : mjFONTSCALE_150; }

[[noreturn]] void Fail(const char* what) {
  throw FileError(fmt::format(
      "no off-screen OpenGL here: {} failed (EGL error {:#x}): run tools/setup --pictures", what,
      static_cast<unsigned>(eglGetError())));
}

// An OpenGL context of this thread without window or display. EGL's display is the process's and
// stays: ending it would unload the driver, whose memory no leak checker could then tell from ours.
class EglContext {
 public:
  EglContext() {
    display_ = eglGetPlatformDisplay(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr);
    if (display_ == EGL_NO_DISPLAY) Fail("eglGetPlatformDisplay");
    if (eglInitialize(display_, nullptr, nullptr) != EGL_TRUE) Fail("eglInitialize");
    if (eglBindAPI(EGL_OPENGL_API) != EGL_TRUE) Fail("eglBindAPI");
    const EGLint wanted[] = {EGL_SURFACE_TYPE,
                             EGL_PBUFFER_BIT,
                             EGL_RENDERABLE_TYPE,
                             EGL_OPENGL_BIT,
                             EGL_RED_SIZE,
                             8,
                             EGL_DEPTH_SIZE,
                             24,
                             EGL_NONE};
    EGLConfig config;
    EGLint n_configs = 0;
    if (eglChooseConfig(display_, wanted, &config, 1, &n_configs) != EGL_TRUE || n_configs == 0) {
      Fail("eglChooseConfig");
    }
    context_ = eglCreateContext(display_, config, EGL_NO_CONTEXT, nullptr);
    if (context_ == EGL_NO_CONTEXT) Fail("eglCreateContext");
    if (eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context_) != EGL_TRUE) {
      Fail("eglMakeCurrent");
    }
  }
  ~EglContext() {
    eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglDestroyContext(display_, context_);
  }
  EglContext(const EglContext&) = delete;
  EglContext& operator=(const EglContext&) = delete;

 private:
  EGLDisplay display_;
  EGLContext context_;
};

}  // namespace

struct Offscreen::Context {
  EglContext egl;
  MujocoSystem* system;
  mjvScene scene;
  mjrContext drawing;
  mjvCamera camera;
  mjvOption options;
  mjrRect area;

  Context(MujocoSystem* drawn, int width, int height) : system(drawn), area{0, 0, width, height} {
    mjModel& model = system->model();
    model.vis.global.offwidth = width;
    model.vis.global.offheight = height;
    mjv_defaultScene(&scene);
    mjr_defaultContext(&drawing);
    mjv_defaultOption(&options);
    mjv_makeScene(&model, &scene, kMaxGeoms);
    mjr_makeContext(&model, &drawing, FontScale(width));
    mjr_setBuffer(mjFB_OFFSCREEN, &drawing);
    mjv_defaultFreeCamera(&model, &camera);
    if (model.ncam > 0) {
      camera.type = mjCAMERA_FIXED;
      camera.fixedcamid = 0;
    }
  }
  ~Context() {
    mjr_freeContext(&drawing);
    mjv_freeScene(&scene);
  }
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  // `height` is a share of the picture's.
  void Write(const std::string& text, float height) {
    mjr_text(mjFONT_NORMAL, text.c_str(), &drawing, 0.02f, height, kInk[0], kInk[1], kInk[2]);
  }

  void AddGhost(MujocoSystem* ghost) {
    mj_forward(&ghost->model(), &ghost->data());
    const int first = scene.ngeom;
    mjv_addGeoms(&ghost->model(), &ghost->data(), &options, nullptr, mjCAT_DYNAMIC, &scene);
    for (mjvGeom* geom = scene.geoms + first; geom != scene.geoms + scene.ngeom; ++geom) {
      std::copy_n(kGhostColour, 4, geom->rgba);
      for (float& size : geom->size) size *= kGhostSize;
      geom->texid = -1;
      geom->transparent = 1;
      geom->category = mjCAT_DECOR;  // no shadow
    }
  }
};

Offscreen::Offscreen(MujocoSystem* system, int width, int height)
    : context_(std::make_unique<Context>(system, width, height)) {}
Offscreen::~Offscreen() = default;

Image Offscreen::Draw(std::span<const std::unique_ptr<MujocoSystem>> ghosts,
                      const std::string& upper, const std::string& lower) {
  Context& c = *context_;
  mjModel& model = c.system->model();
  mjData& data = c.system->data();
  mj_forward(&model, &data);
  mjv_updateScene(&model, &data, &c.options, nullptr, &c.camera, mjCAT_ALL, &c.scene);
  for (const std::unique_ptr<MujocoSystem>& ghost : ghosts) c.AddGhost(ghost.get());
  mjr_render(c.area, &c.scene, &c.drawing);
  c.Write(upper, 0.9f);
  c.Write(lower, 0.03f);
  const std::size_t row = 3 * static_cast<std::size_t>(c.area.width);
  std::vector<std::uint8_t> bottom_first(row * c.area.height);
  mjr_readPixels(bottom_first.data(), nullptr, c.area, &c.drawing);
  Image image{c.area.width, c.area.height, {}};
  for (int y = c.area.height - 1; y >= 0; --y) {
    const auto begin = bottom_first.begin() + static_cast<std::ptrdiff_t>(y * row);
    image.rgb.insert(image.rgb.end(), begin, begin + static_cast<std::ptrdiff_t>(row));
  }
  return image;
}

std::string OffscreenDescription() {
  const EglContext context;
  using GetString = const unsigned char* (*)(unsigned);
  constexpr unsigned kRenderer = 0x1F01;  // GL_RENDERER
  const auto get = reinterpret_cast<GetString>(eglGetProcAddress("glGetString"));
  return fmt::format("EGL, {}", reinterpret_cast<const char*>(get(kRenderer)));
}

}  // namespace downpour
