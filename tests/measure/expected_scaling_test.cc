// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/expected_scaling.h"

#include <doctest/doctest.h>

namespace downpour {
namespace {

// 10 s, a tenth of it serial, on four whole cores, one run with any number of tiles.
ScalingBasis WholeCores() {
  return {.seconds = 10,
          .serial_seconds = 1,
          .generations = {{1, 16 * 5040}},  // a multiple of all numbers up to 10
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
  basis.generations = {{1, 128}, {1, 128}, {1, 128}};
  CHECK(ExpectSpeedUp(basis, 8).speed_up == doctest::Approx(10 / (1 + 9.0 / 8)));
  const ExpectedSpeedUp more = ExpectSpeedUp(basis, 12);
  CHECK(more.speed_up == doctest::Approx(10 / (1 + 9.0 / 8)));
  CHECK(more.bound == "tiles");
  basis.generations = {{1, 48}};  // 24 lanes for each of two threads, which are two vectors
  CHECK(ExpectSpeedUp(basis, 2).speed_up == doctest::Approx(10 / (1 + 9 / 1.5)));
  basis.tile_unit = 8;  // or three of these
  CHECK(ExpectSpeedUp(basis, 2).speed_up == doctest::Approx(10 / (1 + 9.0 / 2)));
}

TEST_CASE("expected_scaling: threads with runs of their own need not divide the lanes of a run") {
  ScalingBasis basis = WholeCores();
  basis.tile_unit = 8;
  basis.generations = {{8, 96}};
  // Two runs of twelve lanes are three vectors, and so are four runs six.
  CHECK(ExpectSpeedUp(basis, 2).speed_up == doctest::Approx(10 / (1 + 9.0 / 2)));
  CHECK(ExpectSpeedUp(basis, 4).speed_up == doctest::Approx(10 / (1 + 9.0 / 4)));
  // Two threads have three runs each, five vectors of which four and a half are used; one has two.
  CHECK(ExpectSpeedUp(basis, 3).speed_up == doctest::Approx(10 / (1 + 9.0 / 2.8)));
  // One thread has two runs, three vectors, and six have one, two vectors.
  CHECK(ExpectSpeedUp(basis, 7).speed_up == doctest::Approx(10 / (1 + 9.0 / 5.5)));
  // One run takes two vectors where one and a half are used.
  CHECK(ExpectSpeedUp(basis, 8).speed_up == doctest::Approx(10 / (1 + 9.0 / 6)));
  CHECK(ExpectSpeedUp(basis, 8).bound == "tiles");
  // Twelve threads share the batch: a vector each.
  CHECK(ExpectSpeedUp(basis, 12).speed_up == doctest::Approx(10 / (1 + 9.0 / 12)));
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
