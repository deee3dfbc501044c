// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/expected_scaling.h"

#include <doctest/doctest.h>

namespace downpour {
namespace {

// 10 s, a tenth of it serial, on four whole cores, batches of any number of tiles.
ScalingBasis WholeCores() {
  return {.seconds = 10,
          .serial_seconds = 1,
          .batch_lanes = {16 * 5040},  // a multiple of all numbers up to 10
          .fma_gain = {1, 2, 3, 4},
          .gigabytes_per_second = {100, 200, 300, 400},
          .demand = 10};
}

TEST_CASE("expected_scaling: on whole cores it is Amdahl's law") {
  for (const int threads : {1, 2, 3, 4, 8}) {
    const ExpectedSpeedUp expected = ExpectSpeedUp(WholeCores(), threads);
    CAPTURE(threads);
    CHECK(expected.speed_up == doctest::Approx(10 / (1 + 9.0 / threads)).epsilon(1e-3));
    CHECK(expected.bound == "FMA");
  }
}

TEST_CASE("expected_scaling: threads that share cores gain what their FMA peak gains") {
  ScalingBasis basis = WholeCores();
  basis.fma_gain = {1, 2, 2.1, 2.2};
  CHECK(ExpectSpeedUp(basis, 4).speed_up == doctest::Approx(10 / (1 + 9 / 2.2)));
  // Cores beyond the measured ones are whole.
  CHECK(ExpectSpeedUp(basis, 6).speed_up == doctest::Approx(10 / (1 + 9 / 4.2)));
}

TEST_CASE("expected_scaling: a batch of eight vectors of lanes keeps eight threads busy") {
  ScalingBasis basis = WholeCores();
  basis.batch_lanes = {128, 128, 128};
  CHECK(ExpectSpeedUp(basis, 8).speed_up == doctest::Approx(10 / (1 + 9.0 / 8)));
  const ExpectedSpeedUp more = ExpectSpeedUp(basis, 12);
  CHECK(more.speed_up == doctest::Approx(10 / (1 + 9.0 / 8)));
  CHECK(more.bound == "tiles");
  basis.batch_lanes = {48};  // three vectors: two of them by one of two threads
  CHECK(ExpectSpeedUp(basis, 2).speed_up == doctest::Approx(10 / (1 + 9 / 1.5)));
}

TEST_CASE("expected_scaling: memory that cores share does not widen beyond the measured") {
  ScalingBasis basis = WholeCores();
  basis.demand = 60;
  basis.gigabytes_per_second = {100, 150, 180, 180};
  basis.shared_memory = true;
  CHECK(ExpectSpeedUp(basis, 8).speed_up == doctest::Approx(10 / (1 + 9.0 / 3)));
  CHECK(ExpectSpeedUp(basis, 8).bound == "bandwidth");
  basis.shared_memory = false;
  CHECK(ExpectSpeedUp(basis, 8).speed_up == doctest::Approx(10 / (1 + 9.0 / 6)));
}

TEST_CASE("expected_scaling: the serial part is what does not shrink with threads") {
  CHECK(SerialSeconds(1.0, 0.6, 2) == doctest::Approx(0.2));
  CHECK(SerialSeconds(1.0, 0.4, 4) == doctest::Approx(0.2));
  CHECK(SerialSeconds(1.0, 1.0, 1) == 1.0);
  CHECK(SerialSeconds(1.0, 1.3, 4) == 1.0);  // threads that hinder each other
  CHECK(SerialSeconds(1.0, 0.1, 4) == 0.0);
}

}  // namespace
}  // namespace downpour
