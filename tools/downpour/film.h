// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "tools/downpour/offscreen.h"

namespace downpour {

// Writes images of one size as one PNG, `columns` of them beside each other, row after row. Throws
// FileError.
void WriteFilmstrip(const std::string& path, const std::vector<Image>& images, int columns);

// A film that ffmpeg writes, MP4 (H.264) or an endless GIF by the ending of its path. Throws
// FileError if the file cannot be written, or there is no ffmpeg.
class Film {
 public:
  Film(const std::string& path, int width, int height, int frames_per_second);
  ~Film();
  Film(const Film&) = delete;
  Film& operator=(const Film&) = delete;

  void Add(const Image& image);
  void Finish();  // after the last image; the file is whole then

 private:
  std::string path_;
  int pid_ = 0;
  int pipe_ = -1;  // ffmpeg's standard input
};

}  // namespace downpour
