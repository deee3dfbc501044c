// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/film.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string_view>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "tools/downpour/png.h"

namespace downpour {
namespace {

constexpr int kGap = 4;  // white, between the pictures of a strip

// ffmpeg's own words for a file that cannot be written take several lines.
void CheckWritable(const std::string& path) {
  errno = 0;
  std::ofstream file(path, std::ios::binary | std::ios::app);
  if (!file) throw FileError(fmt::format("{}: cannot write: {}", path, std::strerror(errno)));
}

std::vector<std::string> Command(const std::string& path, int width, int height, int rate) {
  std::vector<std::string> words = {"ffmpeg",
                                    "-nostdin",
                                    "-loglevel",
                                    "error",
                                    "-y",
                                    "-f",
                                    "rawvideo",
                                    "-pix_fmt",
                                    "rgb24",
                                    "-s",
                                    fmt::format("{}x{}", width, height),
                                    "-r",
                                    std::to_string(rate),
                                    "-i",
                                    "pipe:0"};
  if (path.ends_with(".gif")) {
    // A palette of the film's own colours: GIF's 256 would be a web palette else.
    words.insert(words.end(), {"-filter_complex",
                               "split[a][b];[a]palettegen=stats_mode=diff[p];"
                               "[b][p]paletteuse=dither=bayer:bayer_scale=4"});
  } else {
    words.insert(words.end(), {"-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"});
  }
  words.push_back("file:" + path);
  return words;
}

}  // namespace

void WriteFilmstrip(const std::string& path, const std::vector<Image>& images, int columns) {
  const Image& one = images.front();
  const int rows = (static_cast<int>(images.size()) + columns - 1) / columns;
  Image strip{(one.width + kGap) * columns - kGap, (one.height + kGap) * rows - kGap, {}};
  const std::size_t line = 3 * static_cast<std::size_t>(one.width), whole = 3 * strip.width;
  strip.rgb.assign(whole * strip.height, 255);
  for (std::size_t i = 0; i < images.size(); ++i) {
    const std::size_t first = i / columns * (one.height + kGap);
    const std::size_t left = i % columns * (line + 3 * kGap);
    for (int y = 0; y < one.height; ++y) {
      std::copy_n(&images[i].rgb[y * line], line, &strip.rgb[(first + y) * whole + left]);
    }
  }
  WriteFileAtomically(path, EncodePng(strip));
}

Film::Film(const std::string& path, int width, int height, int frames_per_second) : path_(path) {
  CheckWritable(path);
  std::signal(SIGPIPE, SIG_IGN);  // an ffmpeg that ends early shall give an error, not a signal
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) throw FileError(fmt::format("pipe: {}", std::strerror(errno)));
  pipe_ = ends[1];
  std::vector<std::string> words = Command(path, width, height, frames_per_second);
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, ends[0], STDIN_FILENO);
  const int error = posix_spawnp(&pid_, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(ends[0]);
  if (error == 0) return;
  close(pipe_);
  std::error_code ignored;
  if (std::filesystem::file_size(path, ignored) == 0) std::filesystem::remove(path, ignored);
  throw FileError(
      fmt::format("ffmpeg, which writes {}, cannot be started ({}): run tools/setup --pictures",
                  path, std::strerror(error)));
}

Film::~Film() {
  if (pipe_ < 0) return;
  close(pipe_);
  waitpid(pid_, nullptr, 0);
}

void Film::Add(const Image& image) {
  std::string_view rest(reinterpret_cast<const char*>(image.rgb.data()), image.rgb.size());
  while (!rest.empty()) {
    const ssize_t n = write(pipe_, rest.data(), rest.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) throw FileError(fmt::format("{}: ffmpeg reads no more of the film", path_));
    rest.remove_prefix(static_cast<std::size_t>(n));
  }
}

void Film::Finish() {
  close(pipe_);
  pipe_ = -1;
  int status = 0;
  while (waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
  }
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    throw FileError(fmt::format("{}: ffmpeg could not write it", path_));
  }
}

}  // namespace downpour
