// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/png.h"

#include <fmt/format.h>
#include <png.h>

#include "engine/errors.h"

namespace downpour {

std::string EncodePng(const Image& image) {
  png_image header{};
  header.version = PNG_IMAGE_VERSION;
  header.width = static_cast<png_uint_32>(image.width);
  header.height = static_cast<png_uint_32>(image.height);
  header.format = PNG_FORMAT_RGB;
  std::string bytes(PNG_IMAGE_PNG_SIZE_MAX(header), '\0');
  png_alloc_size_t size = bytes.size();
  if (png_image_write_to_memory(&header, bytes.data(), &size, 0, image.rgb.data(), 0, nullptr) ==
      0) {
    throw FileError(fmt::format("libpng: {}", header.message));
  }
  bytes.resize(size);
  return bytes;
}

}  // namespace downpour
