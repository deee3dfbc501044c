// SPDX-License-Identifier: Apache-2.0
#include "kernels/box/box.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "kernels/box/box_ref.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

constexpr BoxMap kBoxes[] = {
    {-5, 5, 0.3, 0.3}, {-1, 1, 0.1, 0.1}, {0, 0.01, 0.005, 0.005}, {-3, 40, 0.2, 2.05}};

// Numbers over some seven periods, the corners of the map among them.
std::vector<double> Numbers(const BoxMap& box) {
  const double width = box.upper - box.lower;
  std::vector<double> numbers = {box.lower,
                                 box.upper,
                                 box.lower - box.lower_margin,
                                 box.lower + box.lower_margin,
                                 box.upper + box.upper_margin,
                                 box.upper - box.upper_margin};
  for (int i = -701; i <= 701; ++i) numbers.push_back(box.lower + i * width / 50);
  return numbers;
}

TEST_CASE("box: images match the long-double twin on every target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const BoxMap& box : kBoxes) {
      const std::vector<double> numbers = Numbers(box);
      std::vector<double> images = numbers;
      MapToBox(box, images.size(), images.data());
      for (std::size_t i = 0; i < numbers.size(); ++i) {
        CAPTURE(numbers[i]);
        // A few roundings of numbers as large as the argument and the box; slopes are at most 1.
        const double size = std::abs(numbers[i]) + 8 * std::max(-box.lower, box.upper);
        CHECK(std::abs(images[i] - MapToBoxReference(box, numbers[i])) <= 4 * kEps * size);
        CHECK(images[i] >= box.lower);
        CHECK(images[i] <= box.upper);
        if (numbers[i] >= box.lower + box.lower_margin &&
            numbers[i] <= box.upper - box.upper_margin) {
          CHECK(images[i] == numbers[i]);
        }
      }
    }
  });
}

TEST_CASE("box: an image depends on its number alone, and nothing beyond the end is touched") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    const std::vector<double> numbers = Numbers(kBoxes[0]);
    std::vector<double> all = numbers;
    MapToBox(kBoxes[0], all.size(), all.data());
    for (std::size_t n = 0; n <= 40; ++n) {
      std::vector<double> images(numbers.begin(), numbers.begin() + 41);
      MapToBox(kBoxes[0], n, images.data());
      for (std::size_t i = 0; i < n; ++i) CHECK(images[i] == all[i]);
      CHECK(images[n] == numbers[n]);
    }
  });
}

TEST_CASE("box: no number leaves the box however large it is") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (double x = 1; x < 1e300; x *= 7.3) {
      double images[] = {x, -x};
      MapToBox(kBoxes[0], 2, images);
      for (const double image : images) CHECK(std::abs(image) <= 5);
    }
  });
}

}  // namespace
}  // namespace downpour
