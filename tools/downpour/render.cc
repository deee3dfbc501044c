// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <mujoco/mujoco.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <cctype>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "kernels/philox/philox.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/film.h"
#include "tools/downpour/offscreen.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/read_run.h"
#include "tools/downpour/replay.h"

namespace downpour {
namespace {

// A filmstrip's pictures are evenly spaced, start and end included.
constexpr int kStripPictures = 8;
constexpr int kStripColumns = 4;
constexpr int kVideoRate = 30;
constexpr int kGifRate = 25;  // GIF counts in hundredths of a second

struct RenderArguments {
  std::string run;
  std::string output;
  int episode = 0;   // 0: the last
  int rollouts = 5;  // of the model, beside the real one
};

std::vector<Field> RenderFields(RenderArguments& arguments) {
  return {
      EpisodeField(&arguments.episode, "This episode; 0: the last one."),
      {.key = "rollouts",
       .option = "--rollouts",
       .target = &arguments.rollouts,
       .min = 0,
       .max = 100,
       .description = "Rollouts of the episode's model to draw over it, translucent; a random "
                      "episode has none."},
  };
}

// All that is drawn of an episode.
struct Scene {
  const ReadRun& run;
  const EpisodeRecord& record;
  std::vector<Transition> transitions;  // of the episode
  std::optional<Prediction> prediction;
  std::unique_ptr<MujocoSystem> system;
  std::vector<std::unique_ptr<MujocoSystem>> ghosts;  // one a rollout

  const Task& task() const { return run.resolved.task; }
  double seconds() const { return static_cast<double>(transitions.size()) * task().control_period; }
};

std::unique_ptr<MujocoSystem> MakeDrawable(const Task& task) {
  std::unique_ptr<System> system = task.make_system();
  auto* const drawable = dynamic_cast<MujocoSystem*>(system.get());
  if (drawable == nullptr) {
    throw InvalidInput(fmt::format("{} has no MuJoCo model to draw", task.name));
  }
  system.release();
  return std::unique_ptr<MujocoSystem>(drawable);
}

Scene MakeScene(const ReadRun& run, const RenderArguments& arguments) {
  Scene scene{run, FindEpisode(run, arguments.episode), {}, {}, {}, {}};
  for (const Transition& transition : run.state.transitions) {
    if (transition.episode == scene.record.episode) scene.transitions.push_back(transition);
  }
  if (!run.resolved.config.system.program.empty()) {
    throw InvalidInput(fmt::format("{}: is of a robot; must be of a simulated task to be drawn",
                                   run.path.string()));
  }
  scene.system = MakeDrawable(scene.task());
  if (scene.record.random || arguments.rollouts == 0) return scene;
  scene.prediction = PredictSavedEpisode(run, scene.record, arguments.rollouts);
  for (int r = 0; r < arguments.rollouts; ++r) scene.ghosts.push_back(MakeDrawable(scene.task()));
  return scene;
}

// The noise-free start, as the learner drew it.
std::vector<double> StartState(const Scene& scene) {
  const Task& task = scene.task();
  std::vector<double> start(task.states.size());
  FillNormals(DeriveKey(scene.run.resolved.config.learner.seed, StreamPurpose::kStartState,
                        {static_cast<std::uint32_t>(scene.record.episode)}),
              0, start.data(), start.size());
  for (std::size_t e = 0; e < start.size(); ++e) {
    start[e] = task.start_mean[e] + task.start_std[e] * start[e];
  }
  return start;
}

// "Cartpole, episode 3"
std::string Title(const Scene& scene) {
  std::string name = scene.task().name;
  name[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(name[0])));
  return fmt::format("{}, episode {}{}", name, scene.record.episode,
                     scene.record.random ? " (random)" : "");
}

// "blue: 5 model rollouts"; "" if there are none.
std::string Legend(const Scene& scene) {
  if (scene.ghosts.empty()) return "";
  return fmt::format("blue: {} model rollout{}", scene.ghosts.size(),
                     scene.ghosts.size() == 1 ? "" : "s");
}

// "1.7 s   return 3.5", of the steps so far
std::string StepsSoFar(const Scene& scene, double time) {
  const auto n_steps = static_cast<std::size_t>(time / scene.task().control_period + 1e-9);
  double total = 0;
  for (std::size_t i = 0; i < n_steps; ++i) total += scene.transitions[i].reward;
  return fmt::format("{:.1f} s   return {:.1f}", time, total);
}

// Puts the ghosts where the rollouts are at `time`.
void PlaceGhosts(double time, Scene* scene) {
  const Task& task = scene->task();
  const std::size_t row = static_cast<std::size_t>(task.n_states()) * (task.horizon + 1);
  for (std::size_t r = 0; r < scene->ghosts.size(); ++r) {
    const std::span<const double> states = scene->prediction->trajectories.states;
    scene->ghosts[r]->Reset(
        Interpolate(states.subspan(r * row, row), task.n_states(), time / task.control_period));
  }
}

// Draws the scene at all `times` (s) and hands on each picture. `titles`: of the first ones; the
// last of them goes on.
void DrawAll(const std::vector<double>& times, int width, int height,
             const std::vector<std::string>& titles, Scene* scene,
             const std::function<void(const Image&)>& use) {
  const std::vector<std::vector<double>> poses =
      Replay(scene->task(), scene->system.get(), StartState(*scene), scene->transitions, times);
  Offscreen offscreen(scene->system.get(), width, height);
  for (std::size_t i = 0; i < times.size(); ++i) {
    std::copy(poses[i].begin(), poses[i].end(), scene->system->data().qpos);
    PlaceGhosts(times[i], scene);
    use(offscreen.Draw(scene->ghosts, titles[std::min(i, titles.size() - 1)],
                       StepsSoFar(*scene, times[i])));
  }
}

void DrawFilmstrip(const std::string& path, Scene* scene) {
  std::vector<double> times;
  for (int i = 0; i < kStripPictures; ++i) {
    times.push_back(scene->seconds() * i / (kStripPictures - 1));
  }
  std::vector<Image> images;
  DrawAll(times, 400, 300, {Title(*scene), Legend(*scene), ""}, scene,
          [&](const Image& image) { images.push_back(image); });
  WriteFilmstrip(path, images, kStripColumns);
}

void DrawFilm(const std::string& path, int width, int height, int rate, Scene* scene) {
  std::vector<double> times;
  for (int i = 0; i <= std::lround(scene->seconds() * rate); ++i) {
    times.push_back(std::min(static_cast<double>(i) / rate, scene->seconds()));
  }
  Film film(path, width, height, rate);
  Image last;
  const std::string title = Title(*scene) + "   " + Legend(*scene);
  DrawAll(times, width, height, {title}, scene, [&](const Image& image) {
    film.Add(image);
    last = image;
  });
  for (int i = 0; i < rate; ++i) film.Add(last);  // the end stands for a second
  film.Finish();
}

void Render(RenderArguments arguments) {
  const bool png = arguments.output.ends_with(".png"), gif = arguments.output.ends_with(".gif");
  if (!arguments.output.empty() && !png && !gif && !arguments.output.ends_with(".mp4")) {
    throw InvalidInput(
        fmt::format("--output: {}: must end in .png, .gif or .mp4", arguments.output));
  }
  const ReadRun run = ReadRunDirectory(arguments.run);
  Scene scene = MakeScene(run, arguments);
  if (arguments.output.empty()) {
    arguments.output = (run.path / fmt::format("episode_{}.png", scene.record.episode)).string();
  }
  if (arguments.output.ends_with(".png")) {
    DrawFilmstrip(arguments.output, &scene);
  } else if (gif) {
    DrawFilm(arguments.output, 640, 360, kGifRate, &scene);
  } else {
    DrawFilm(arguments.output, 1280, 720, kVideoRate, &scene);
  }
  fmt::print("{}\n", arguments.output);
}

}  // namespace

void AddRenderCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand(
      "render", "Draw an episode of a run and what its model expected, as a filmstrip or a film");
  auto arguments = std::make_shared<RenderArguments>();
  command->add_option("RUN", arguments->run, "Run directory")->required()->check(NotEmpty());
  command
      ->add_option("-o,--output", arguments->output,
                   "Picture: .png a filmstrip, .gif or .mp4 a film (needs ffmpeg) "
                   "(default RUN/episode_K.png)")
      ->type_name("FILE")
      ->check(NotEmpty());
  RunWithFields(command, arguments, RenderFields, Render);
}

}  // namespace downpour
