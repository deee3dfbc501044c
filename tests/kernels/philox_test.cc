// SPDX-License-Identifier: Apache-2.0
#include "kernels/philox/philox.h"

#include <Random123/philox.h>
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "kernels/aligned.h"
#include "kernels/philox/philox_ref.h"
#include "tests/kernels/each_target.h"

namespace downpour {
namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();

// log 4 ulp, sqrt halves it and adds 0.5, cos/sin 3 ulp of their result plus the rounding of the
// angle (up to 2 pi eps/2), two products: absolute error in units of eps times the radius.
double NormalTolerance(long double radius) { return static_cast<double>(radius) * 16 * kEps; }

TEST_CASE("philox: gives Random123's published known answers") {
  CHECK(PhiloxReference({0, 0, 0, 0}, {0, 0}) ==
        PhiloxBlock{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8});
  const std::uint32_t f = 0xffffffff;
  CHECK(PhiloxReference({f, f, f, f}, {f, f}) ==
        PhiloxBlock{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd});
  CHECK(
      PhiloxReference({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}) ==
      PhiloxBlock{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1});
}

TEST_CASE("philox: equals the Random123 library on arbitrary counters and keys") {
  r123::Philox4x32 generator;
  for (std::uint32_t i = 0; i < 1000; ++i) {
    const std::uint32_t a = i * 2654435761u, b = i * i * 40503u + 7;
    const auto expected = generator({{a, b, ~a, i}}, {{b, a ^ 0x55u}});
    const PhiloxBlock got = PhiloxReference({a, b, ~a, i}, {b, a ^ 0x55u});
    CHECK(std::equal(got.begin(), got.end(), expected.begin()));
  }
}

TEST_CASE("philox: uniforms equal the scalar twin for every length and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    const StreamKey key{12, 0xdeadbeef};
    for (std::size_t n = 0; n <= 40; ++n) {
      std::vector<double> out(n + 1, -7.0);
      FillUniforms(key, 9, out.data(), n);
      for (std::uint32_t i = 0; i < n; ++i) {
        CHECK(out[i] == UniformPairReference({i / 2, 9, 0, 0}, key)[i % 2]);
      }
      CHECK(out[n] == -7.0);  // nothing is written beyond the end
    }
  });
}

TEST_CASE("philox: normals match the long-double twin for every length and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    const StreamKey key{3, 4};
    for (const std::size_t n : {0, 1, 2, 7, 16, 17, 20000}) {
      std::vector<double> out(n);
      FillNormals(key, 5, out.data(), n);
      for (std::uint32_t i = 0; i < n; ++i) {
        const auto pair = NormalPairReference({i / 2, 5, 0, 0}, key);
        CHECK(std::abs(out[i] - pair[i % 2]) <= NormalTolerance(std::hypot(pair[0], pair[1])));
      }
    }
  });
}

TEST_CASE("philox: columns are the bits of one stream a column, for every size and target") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    const StreamKey key{3, 4};
    for (const std::uint32_t columns : {0, 1, 2, 3, 4, 5, 16}) {
      for (const std::size_t n : {1, 2, 7, 16, 17, 32, 33, 71}) {
        std::vector<double> out(n * columns + 1, -7.0), column(n);
        FillNormalColumns(key, 5, columns, out.data(), n);
        for (std::uint32_t c = 0; c < columns; ++c) {
          FillNormals(key, 5 + c, column.data(), n);
          CHECK(std::equal(column.begin(), column.end(), out.data() + c * n));
        }
        CHECK(out[n * columns] == -7.0);
      }
    }
  });
}

TEST_CASE("philox: a tile's normals are keyed by lane, rollout and step alone") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    std::uint32_t keys0[kTileLanes], keys1[kTileLanes], rollouts[kTileLanes];
    for (std::uint32_t lane = 0; lane < kTileLanes; ++lane) {
      keys0[lane] = lane * 77;
      keys1[lane] = ~lane;
      rollouts[lane] = lane % 5;
    }
    for (int variables = 1; variables <= 5; ++variables) {
      AlignedVector<double> out(variables * kTileLanes);
      NormalTile(kTileLanes, keys0, keys1, rollouts, 39, variables, out.data());
      for (int lane = 0; lane < kTileLanes; ++lane) {
        for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(variables); ++v) {
          const auto pair =
              NormalPairReference({v / 2, 39, rollouts[lane], 0}, {keys0[lane], keys1[lane]});
          CHECK(std::abs(out[v * kTileLanes + lane] - pair[v % 2]) <=
                NormalTolerance(std::hypot(pair[0], pair[1])));
        }
      }
    }
  });
}

TEST_CASE("philox: a tile's normals are those of the lanes in use") {
  ForEachTarget([](const char* target) {
    CAPTURE(target);
    const std::vector<std::uint32_t> keys(kTileLanes, 3), rollouts(kTileLanes, 5);
    AlignedVector<double> all(3 * kTileLanes);
    NormalTile(kTileLanes, keys.data(), keys.data(), rollouts.data(), 7, 3, all.data());
    for (const int n_lanes : {1, 8, 9, kTileLanes - 1}) {
      AlignedVector<double> some(3 * kTileLanes, 100.0);
      NormalTile(n_lanes, keys.data(), keys.data(), rollouts.data(), 7, 3, some.data());
      for (int v = 0; v < 3; ++v) {
        const auto row = some.begin() + v * kTileLanes;
        CHECK(std::equal(row, row + n_lanes, all.begin() + v * kTileLanes));
        // Vectors have eight lanes at most.
        const int end = (n_lanes + 7) / 8 * 8;
        CHECK(std::all_of(row + end, row + kTileLanes, [](double z) { return z == 100.0; }));
      }
    }
  });
}

TEST_CASE("philox: normals have the moments of a standard normal distribution") {
  const std::size_t n = 1 << 20;
  std::vector<double> z(n);
  FillNormals({1, 2}, 0, z.data(), n);
  double m1 = 0, m2 = 0, m4 = 0, product = 0;
  for (std::size_t i = 0; i < n; ++i) {
    m1 += z[i];
    m2 += z[i] * z[i];
    m4 += z[i] * z[i] * z[i] * z[i];
    if (i % 2) product += z[i] * z[i - 1];
  }
  // Five standard errors of each moment.
  CHECK(std::abs(m1 / n) < 5 / std::sqrt(n));
  CHECK(std::abs(m2 / n - 1) < 5 * std::sqrt(2.0 / n));
  CHECK(std::abs(m4 / n - 3) < 5 * std::sqrt(96.0 / n));
  CHECK(std::abs(product / (n / 2)) < 5 / std::sqrt(n / 2));
}

TEST_CASE("philox: keys differ for different seeds, purposes, paths and path lengths") {
  const auto purpose = StreamPurpose::kRollout;
  std::vector<StreamKey> keys = {DeriveKey(0, purpose, {}),
                                 DeriveKey(0, purpose, {0}),
                                 DeriveKey(0, purpose, {0, 0}),
                                 DeriveKey(1, purpose, {0, 0}),
                                 DeriveKey(std::uint64_t{1} << 32, purpose, {0, 0}),
                                 DeriveKey(0, StreamPurpose::kEvaluate, {0, 0}),
                                 DeriveKey(0, purpose, {1, 0}),
                                 DeriveKey(0, purpose, {0, 1})};
  for (std::size_t i = 0; i < keys.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) CHECK_FALSE(keys[i] == keys[j]);
  }
}

TEST_CASE("philox: the keys of a path's children are those derived one by one") {
  const auto purpose = StreamPurpose::kRollout;
  std::vector<StreamKey> top(3), deep(5);
  DeriveKeys(9, purpose, {}, top);
  DeriveKeys(9, purpose, {4, 0, 7}, deep);
  for (std::uint32_t i = 0; i < 3; ++i) CHECK(top[i] == DeriveKey(9, purpose, {i}));
  for (std::uint32_t i = 0; i < 5; ++i) CHECK(deep[i] == DeriveKey(9, purpose, {4, 0, 7, i}));
}

}  // namespace
}  // namespace downpour
