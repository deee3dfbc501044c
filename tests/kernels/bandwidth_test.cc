// SPDX-License-Identifier: Apache-2.0
#include "kernels/bandwidth/bandwidth.h"

#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "kernels/aligned.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

TEST_CASE("bandwidth: every value is read once, for every tail size") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    for (const std::size_t n : {0, 1, 7, 8, 63, 64, 65, 128, 1000, 1031}) {
      AlignedVector<double> data(n + 1);
      TestNumbers random(n);
      long double sum = 0, magnitude = 0;
      for (std::size_t i = 0; i < n; ++i) {
        data[i] = random();
        sum += data[i];
        magnitude += std::abs(data[i]);
      }
      data[n] = NAN;  // not to be read
      const double error = static_cast<double>(
          std::abs(static_cast<long double>(SumOfDoubles(data.data(), n)) - sum));
      CAPTURE(n);
      CHECK(error <= static_cast<double>(magnitude) * static_cast<double>(n) * 1.2e-16);
    }
  });
}

TEST_CASE("bandwidth: rates are possible for one core") {
  for (const std::size_t n : {1, 1000, 100000}) {
    const AlignedVector<double> data(n, 1.0);
    const double rate = ReadBandwidth(data.data(), n, 0.01);
    CAPTURE(n);
    CHECK(rate > 0.001);  // one value in 8 us: a call without its vector kernel on a slow machine
    CHECK(rate < 2000);   // 2 loads of 64 bytes a cycle x 15 GHz
  }
}

}  // namespace
}  // namespace downpour
