// SPDX-License-Identifier: Apache-2.0
#include "kernels/philox/philox.h"

#include <algorithm>

#include "kernels/aligned.h"
#include "kernels/philox/philox_ref.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/philox/philox.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/philox/box_muller-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using DF = hn::ScalableTag<double>;
using DU = hn::RebindToUnsigned<DF>;
using VF = hn::Vec<DF>;
using VU = hn::Vec<DU>;

// Each 32-bit word sits in the low half of a 64-bit lane, so that one widening multiply of the even
// words serves a round and the results are already the width of a double.
struct Words {
  VU w0, w1, w2, w3;
};

// Product of the low words.
HWY_INLINE VU WideningMultiply(VU a, std::uint32_t b) {
#if HWY_TARGET == HWY_SCALAR  // has no widening multiply; its 64-bit one is exact here
  return hn::Mul(hn::And(a, hn::Set(DU(), 0xFFFFFFFFu)), hn::Set(DU(), std::uint64_t{b}));
#else
  const hn::Repartition<std::uint32_t, DU> du32;
  return hn::MulEven(hn::BitCast(du32, a), hn::Set(du32, b));
#endif
}

constexpr int kRounds = 10;

// Keys of the rounds of one stream, which every lane shares.
class SharedKeys {
 public:
  explicit SharedKeys(StreamKey key) {
    for (int round = 0; round < kRounds; ++round) {
      words_[round][0] = key.word0 + std::uint64_t{kPhiloxWeyl0} * round;
      words_[round][1] = key.word1 + std::uint64_t{kPhiloxWeyl1} * round;
    }
  }
  VU Get(int round, int word) const { return hn::Set(DU(), words_[round][word]); }

 private:
  std::uint64_t words_[kRounds][2];
};

// Those of a stream a lane.
struct LaneKeys {
  VU Get(int round, int word) const {
    const std::uint64_t weyl = word == 0 ? kPhiloxWeyl0 : kPhiloxWeyl1;
    return hn::Add(words[word], hn::Set(DU(), weyl * round));
  }

  VU words[2];
};

// Only the low halves of the words are read, and right: nothing carries into them.
template <class Keys, std::size_t kVectors>
HWY_INLINE void Rounds(const Keys& keys, Words (&x)[kVectors]) {
  for (int round = 0; round < kRounds; ++round) {
    const VU key0 = keys.Get(round, 0), key1 = keys.Get(round, 1);
    for (Words& w : x) {
      const VU p0 = WideningMultiply(w.w0, kPhiloxMultiplier0);
      const VU p1 = WideningMultiply(w.w2, kPhiloxMultiplier1);
      w = {hn::Xor3(hn::ShiftRight<32>(p1), w.w1, key0), p1,
           hn::Xor3(hn::ShiftRight<32>(p0), w.w3, key1), p0};
    }
  }
}

// 52 random bits as the mantissa of a number in [1, 2), less 1.
HWY_INLINE VF Uniform(VU low, VU high) {
  const DF df;
  const DU du;
  const VU bits = hn::Or(hn::ShiftLeft<32>(high), hn::And(low, hn::Set(du, 0xFFFFFFFFu)));
  const VU one_to_two = hn::Or(hn::ShiftRight<12>(bits), hn::Set(du, 0x3FF0000000000000ull));
  return hn::Sub(hn::BitCast(df, one_to_two), hn::Set(df, 1.0));
}

struct Pair {
  VF first, second;
};

HWY_INLINE Pair Uniforms(const Words& bits) {
  return {Uniform(bits.w0, bits.w1), Uniform(bits.w2, bits.w3)};
}

HWY_INLINE Pair Normals(const Words& bits) {
  const DF df;
  const auto [u1, u2] = Uniforms(bits);
  const VF log_u1 = LogOfUniform(df, hn::Sub(hn::Set(df, 1.0), u1));
  const VF radius = hn::Sqrt(hn::Mul(hn::Set(df, -2.0), log_u1));
  VF cosine, sine;
  CosSinOfTurns(df, u2, &cosine, &sine);
  return {hn::Mul(radius, cosine), hn::Mul(radius, sine)};
}

// Blocks [first, first + Lanes) of a column.
struct BlockVector {
  std::uint32_t column;
  std::size_t first;
};

// Column c of `out` (n x columns) from the blocks with counter1 + c. Vectors of blocks take turns,
// as the rounds of one wait for each other.
template <Pair (*kDraw)(const Words&)>
HWY_INLINE void Fill(StreamKey key, std::uint32_t counter1, std::uint32_t columns, double* out,
                     std::size_t n) {
  const DF df;
  const DU du;
  constexpr std::size_t kVectors = 4;
  const std::size_t lanes = hn::Lanes(df);
  const std::size_t per_column = (n + 2 * lanes - 1) / (2 * lanes);
  const SharedKeys keys(key);
  const VU lane = hn::Iota(du, 0);  // with a variable start it would go through memory
  BlockVector next{0, 0};
  for (std::size_t left = per_column * columns; left > 0; left -= std::min(left, kVectors)) {
    BlockVector at[kVectors];
    Words x[kVectors];
    for (std::size_t v = 0; v < kVectors; ++v) {
      at[v] = next;
      x[v] = {hn::Add(lane, hn::Set(du, next.first)), hn::Set(du, counter1 + next.column),
              hn::Zero(du), hn::Zero(du)};
      next.first += lanes;
      if (2 * next.first >= n) next = {next.column + 1, 0};
    }
    Rounds(keys, x);
    for (std::size_t v = 0; v < std::min(left, kVectors); ++v) {
      const Pair pair = kDraw(x[v]);
      double* const to = out + at[v].column * n + 2 * at[v].first;
      const std::size_t room = n - 2 * at[v].first;
      if (room >= 2 * lanes) {
        hn::StoreInterleaved2(pair.first, pair.second, df, to);
      } else {
        HWY_ALIGN double buffer[2 * hn::MaxLanes(DF())];
        hn::StoreInterleaved2(pair.first, pair.second, df, buffer);
        std::copy_n(buffer, room, to);
      }
    }
  }
}

void FillNormalsTarget(StreamKey key, std::uint32_t counter1, std::uint32_t columns, double* out,
                       std::size_t n) {
  Fill<Normals>(key, counter1, columns, out, n);
}

void FillUniformsTarget(StreamKey key, std::uint32_t counter1, double* out, std::size_t n) {
  Fill<Uniforms>(key, counter1, 1, out, n);
}

void NormalTileTarget(int n_lanes, const std::uint32_t* keys0, const std::uint32_t* keys1,
                      const std::uint32_t* rollouts, std::uint32_t step, int n_variables,
                      double* out) {
  const DF df;
  const DU du;
  const hn::Rebind<std::uint32_t, DU> du32;
  for (int lane = 0; lane < n_lanes; lane += static_cast<int>(hn::Lanes(df))) {
    const LaneKeys keys{{hn::PromoteTo(du, hn::LoadU(du32, keys0 + lane)),
                         hn::PromoteTo(du, hn::LoadU(du32, keys1 + lane))}};
    const VU rollout = hn::PromoteTo(du, hn::LoadU(du32, rollouts + lane));
    for (int v = 0; v < n_variables; v += 2) {
      const VU block = hn::Set(du, static_cast<std::uint64_t>(v / 2));
      Words x[1] = {{block, hn::Set(du, step), rollout, hn::Zero(du)}};
      Rounds(keys, x);
      const Pair z = Normals(x[0]);
      hn::Store(z.first, df, out + v * kTileLanes + lane);
      if (v + 1 < n_variables) hn::Store(z.second, df, out + (v + 1) * kTileLanes + lane);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(FillNormalsTarget);
HWY_EXPORT(FillUniformsTarget);
HWY_EXPORT(NormalTileTarget);

namespace {

// A Philox block is a keyed permutation: absorbing a coordinate at a time makes a hash chain.
PhiloxBlock Absorb(const PhiloxBlock& state, std::uint32_t coordinate, std::size_t position) {
  return PhiloxReference({state[2], state[3], coordinate, static_cast<std::uint32_t>(position)},
                         {state[0], state[1]});
}

PhiloxBlock AbsorbPath(std::uint64_t seed, StreamPurpose purpose,
                       std::initializer_list<std::uint32_t> path) {
  PhiloxBlock state = {static_cast<std::uint32_t>(purpose), 0, 0, 0};
  state = PhiloxReference(
      state, {static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32)});
  std::size_t position = 1;
  for (const std::uint32_t coordinate : path) state = Absorb(state, coordinate, position++);
  return state;
}

}  // namespace

StreamKey DeriveKey(std::uint64_t seed, StreamPurpose purpose,
                    std::initializer_list<std::uint32_t> path) {
  const PhiloxBlock state = AbsorbPath(seed, purpose, path);
  return {state[0], state[1]};
}

void DeriveKeys(std::uint64_t seed, StreamPurpose purpose,
                std::initializer_list<std::uint32_t> path, std::span<StreamKey> keys) {
  const PhiloxBlock parent = AbsorbPath(seed, purpose, path);
  for (std::size_t i = 0; i < keys.size(); ++i) {
    const PhiloxBlock state = Absorb(parent, static_cast<std::uint32_t>(i), path.size() + 1);
    keys[i] = {state[0], state[1]};
  }
}

void FillNormals(StreamKey key, std::uint32_t counter1, double* out, std::size_t n) {
  HWY_DYNAMIC_DISPATCH(FillNormalsTarget)(key, counter1, 1, out, n);
}

void FillNormalColumns(StreamKey key, std::uint32_t counter1, std::uint32_t columns, double* out,
                       std::size_t n) {
  HWY_DYNAMIC_DISPATCH(FillNormalsTarget)(key, counter1, columns, out, n);
}

void FillUniforms(StreamKey key, std::uint32_t counter1, double* out, std::size_t n) {
  HWY_DYNAMIC_DISPATCH(FillUniformsTarget)(key, counter1, out, n);
}

void NormalTile(int n_lanes, const std::uint32_t* keys0, const std::uint32_t* keys1,
                const std::uint32_t* rollouts, std::uint32_t step, int n_variables, double* out) {
  HWY_DYNAMIC_DISPATCH(NormalTileTarget)(n_lanes, keys0, keys1, rollouts, step, n_variables, out);
}

}  // namespace downpour
#endif  // HWY_ONCE
