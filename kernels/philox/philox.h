// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <span>

namespace downpour {

// Counter-based randomness: Philox4x32-10 (Salmon et al., SC 2011). A number depends only on its
// key and counter, never on the thread, the tile or the order in which numbers are drawn.

// Key of one independent stream of random numbers.
struct StreamKey {
  std::uint32_t word0 = 0;
  std::uint32_t word1 = 0;
  bool operator==(const StreamKey&) const = default;
};

// What a stream is for: the first coordinate of DeriveKey's path, so that no two uses share one.
enum class StreamPurpose : std::uint32_t {
  kRandomEpisode = 1,
  kObservationNoise = 2,
  kStartState = 3,
  kModelRestart = 4,
  kSearchSampling = 5,
  kSearchRestart = 6,
  kReevaluation = 7,
  kRollout = 8,
  kFinalEvaluation = 9,
  kEvaluate = 10,
  kPlanProbe = 11,
  kPrediction = 12,
  kPriorRestart = 13,
  kPilcoStart = 14,
};

// Key of the stream at `path` (at most 8 coordinates, e.g. {episode, run, generation}) under
// `seed`. Seed 0 is an ordinary seed. Distinct (seed, purpose, path) give unrelated keys: the
// coordinates are absorbed by a chain of Philox blocks.
StreamKey DeriveKey(std::uint64_t seed, StreamPurpose purpose,
                    std::initializer_list<std::uint32_t> path);

// keys[i] = DeriveKey(seed, purpose, {path..., i}) for every i, in a fraction of the time.
void DeriveKeys(std::uint64_t seed, StreamPurpose purpose,
                std::initializer_list<std::uint32_t> path, std::span<StreamKey> keys);

// Fills out[0, n) with standard normal numbers of the stream: numbers 2i and 2i+1 are the
// Box-Muller pair of block i (counter {i, counter1, 0, 0}). `out` needs no alignment. Vectorised;
// the bits are the same for every n on one SIMD target. Thread-safe, does not allocate.
// The two 64-bit halves of a block give u1 in (0, 1] and u2 in [0, 1), multiples of 2^-52, so that
// |z| <= sqrt(104 ln 2) = 8.49; z = sqrt(-2 ln u1) (cos 2 pi u2, sin 2 pi u2).
void FillNormals(StreamKey key, std::uint32_t counter1, double* out, std::size_t n);

// FillNormals(key, counter1 + c, out + c n, n) for every c in [0, columns), in less time.
void FillNormalColumns(StreamKey key, std::uint32_t counter1, std::uint32_t columns, double* out,
                       std::size_t n);

// The same stream as uniform numbers in [0, 1), multiples of 2^-52: numbers 2i and 2i+1 are the
// halves of block i.
void FillUniforms(StreamKey key, std::uint32_t counter1, double* out, std::size_t n);

// Standard normal numbers for a tile: out[v][lane] for v in [0, n_variables), from the stream
// (keys0[lane], keys1[lane]) at counter {v / 2, step, rollout[lane], 0}. `out` is
// n_variables x kTileLanes, aligned; keys and rollout have kTileLanes entries. Lanes from n_lanes
// on, rounded up to whole vectors, are left as they are.
void NormalTile(int n_lanes, const std::uint32_t* keys0, const std::uint32_t* keys1,
                const std::uint32_t* rollouts, std::uint32_t step, int n_variables, double* out);

}  // namespace downpour
