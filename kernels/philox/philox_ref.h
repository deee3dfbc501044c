// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "kernels/philox/philox.h"

namespace downpour {

// Constants of Philox4x32 (Salmon et al. 2011, table 2).
inline constexpr std::uint32_t kPhiloxMultiplier0 = 0xD2511F53;
inline constexpr std::uint32_t kPhiloxMultiplier1 = 0xCD9E8D57;
inline constexpr std::uint32_t kPhiloxWeyl0 = 0x9E3779B9;  // golden ratio
inline constexpr std::uint32_t kPhiloxWeyl1 = 0xBB67AE85;  // sqrt(3) - 1

using PhiloxBlock = std::array<std::uint32_t, 4>;

// Scalar twin of the vectorised generator.
inline PhiloxBlock PhiloxReference(PhiloxBlock x, StreamKey key) {
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t p0 = std::uint64_t{kPhiloxMultiplier0} * x[0];
    const std::uint64_t p1 = std::uint64_t{kPhiloxMultiplier1} * x[2];
    x = {static_cast<std::uint32_t>(p1 >> 32) ^ x[1] ^ key.word0, static_cast<std::uint32_t>(p1),
         static_cast<std::uint32_t>(p0 >> 32) ^ x[3] ^ key.word1, static_cast<std::uint32_t>(p0)};
    key.word0 += kPhiloxWeyl0;
    key.word1 += kPhiloxWeyl1;
  }
  return x;
}

// The two uniform numbers in [0, 1) of a block.
inline std::array<double, 2> UniformPairReference(const PhiloxBlock& counter, StreamKey key) {
  const PhiloxBlock r = PhiloxReference(counter, key);
  const auto uniform = [](std::uint32_t low, std::uint32_t high) {
    return std::ldexp(static_cast<double>((std::uint64_t{high} << 32 | low) >> 12), -52);
  };
  return {uniform(r[0], r[1]), uniform(r[2], r[3])};
}

// The two normal numbers of a block, in long double.
inline std::array<long double, 2> NormalPairReference(const PhiloxBlock& counter, StreamKey key) {
  const auto u = UniformPairReference(counter, key);
  const long double radius = std::sqrt(-2 * std::log(1 - static_cast<long double>(u[0])));
  const long double angle = 6.283185307179586476925286766559L * u[1];
  return {radius * std::cos(angle), radius * std::sin(angle)};
}

}  // namespace downpour
