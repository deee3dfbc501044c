// SPDX-License-Identifier: Apache-2.0
#include "kernels/gp_query/gp_query.h"

#include <cstddef>
#include <type_traits>

#include "kernels/gp_query/triangle_layout.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/gp_query/gp_query.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"
#include "kernels/gp_query/covariances-inl.h"
#include "kernels/gp_query/group-inl.h"
#include "kernels/gp_query/narrow-inl.h"
#include "kernels/gp_query/panel-inl.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Calls body(std::integral_constant<int, width>(), first) for the groups of 3, 2 or 1 vectors that
// `vectors` vectors of lanes are cut into. Groups of one, which load more than they compute, are
// avoided.
template <class Body>
HWY_INLINE void ForEachGroup(int vectors, const Body& body) {
  int first = 0;
  for (; vectors - first == 3 || vectors - first > 4; first += 3) {
    body(std::integral_constant<int, 3>(), first);
  }
  for (; vectors - first >= 2; first += 2) body(std::integral_constant<int, 2>(), first);
  if (vectors - first == 1) body(std::integral_constant<int, 1>(), first);
}

// The groups that `vectors` vectors are cut into.
constexpr int GroupCount(int vectors) { return (vectors + 2) / 3; }

// Elements that a group fetches of the chunk that follows at a pair of columns.
constexpr int FetchShare(int n_groups) { return (2 * kRowBlock + n_groups - 1) / n_groups; }

// Whether a group fetches all that it can. Groups of three vectors of 64 bytes need less while the
// triangle is not much larger than the second-level cache: the processor's own fetching then costs
// them 2 % of the cycles, but the clock was seen to fall with the number of loads and fetches, so
// that asking for less saved up to 6 % of the time. One group alone has twice as much to fetch.
// With 16 registers nothing of a triangle below 512 KiB is fetched: this saves 1 to 2 %, with eight
// lanes 7 % (Zen 3).
template <int kWidth, typename T>
HWY_INLINE bool FetchesAll(const GpFactorT<T>& f, int vectors) {
  const std::size_t kibibytes = (f.triangle.size() * sizeof(T)) >> 10;
  if constexpr (!kManyRegisters) return kibibytes >= 512;
  return kWidth < 3 || kibibytes >= 8192 || FetchShare(GroupCount(vectors)) * sizeof(T) > 64;
}

// What the group of kWidth vectors from `first` on fetches during a chunk, evenly: its share of the
// chunk that follows, and its own part of e for that chunk.
template <int kWidth, typename T>
HWY_INLINE void PlanFetches(const TriangleChunk& chunk, const T* next_chunk, const T* e, int first,
                            int vectors, Fetch<T> (&fetch)[2]) {
  const int lanes = kWidth * static_cast<int>(hn::Lanes(hn::ScalableTag<T>()));
  const int n_groups = GroupCount(vectors), group = GroupCount(first);
  const int share = FetchShare(n_groups);
  const T* const from = next_chunk + chunk.size * group / n_groups;
  if (share * sizeof(T) <= 64) {
    const int column = chunk.end_column < chunk.end_row ? chunk.end_column : 0;
    fetch[0] = {from, share};
    fetch[1] = {e + column * lanes, 2 * kRowBlock * lanes / kChunkRows};
  } else {
    fetch[0] = {from, share / 2};
    fetch[1] = {from + chunk.size / 2, share / 2};
  }
}

// Adds a chunk's panels for the group of kWidth vectors from `first` on.
template <int kWidth, bool kFetchAll, typename T>
HWY_INLINE void AddChunk(const GpFactorT<T>& f, const TriangleChunk& chunk, const Group<T>& group,
                         int first, int vectors) {
  const std::size_t lanes = kWidth * hn::Lanes(hn::ScalableTag<T>());
  const T* w = f.triangle.data() + chunk.offset;
  Fetch<T> fetch[2];
  PlanFetches<kWidth>(chunk, w + chunk.size, group.e, first, vectors, fetch);
  for (int row = chunk.row; row < chunk.end_row; row += kRowBlock) {
    const int n_columns = chunk.Columns(row);
    const bool diagonal = chunk.column + n_columns == row + kRowBlock;
    AddPanel<kWidth, kFetchAll>(
        w, n_columns, chunk.column == 0, diagonal, fetch, group.e + chunk.column * lanes,
        group.rows + (row - chunk.row) * lanes, row > 0 ? group.variance : nullptr);
    if (row == 0) {
      const hn::ScalableTag<double> d;
      StartVariance(d, f.signal_variance, group, static_cast<int>(lanes));
    }
    w += kRowBlock * n_columns;
    for (Fetch<T>& part : fetch) part.from += part.step * n_columns / 2;
  }
}

template <typename T>
void QueryTile(const GpFactorT<T>& f, int n_lanes, const double* HWY_RESTRICT x,
               T* HWY_RESTRICT scratch, double* HWY_RESTRICT mean, double* HWY_RESTRICT variance) {
  const int lanes = static_cast<int>(hn::Lanes(hn::ScalableTag<T>()));
  if (n_lanes <= MostNarrow(f)) return QueryOneByOne(f, n_lanes, x, scratch, mean, variance);
  const int vectors = (n_lanes + lanes - 1) / lanes;
  const auto group_at = [&](int width, int first) {
    return Group<T>(f, width * lanes, scratch + Group<T>::Rows(f) * first * lanes);
  };
  const hn::ScalableTag<double> d;
  ForEachGroup(vectors, [&](auto width, int first) {
    const Group<T> group = group_at(width, first);
    ScaleQueries(d, f, x + first * lanes, width * lanes, group.queries);
    CovariancesAndMean<width>(f, group.queries, group.e, group.mean);
  });
  if (variance != nullptr) {
    ForEachChunk(f.n_padded, [&](const TriangleChunk& chunk) {
      ForEachGroup(vectors, [&](auto width, int first) {
        const Group<T> group = group_at(width, first);
        if (FetchesAll<width>(f, vectors)) {
          AddChunk<width, true>(f, chunk, group, first, vectors);
        } else {
          AddChunk<width, false>(f, chunk, group, first, vectors);
        }
      });
    });
  }
  ForEachGroup(vectors, [&](auto width, int first) {
    WriteResults(d, group_at(width, first), width * lanes, mean + first * lanes,
                 variance == nullptr ? nullptr : variance + first * lanes);
  });
}

void QueryTileDouble(const GpFactor& f, int n_lanes, const double* x, void* scratch, double* mean,
                     double* variance) {
  QueryTile(f, n_lanes, x, static_cast<double*>(scratch), mean, variance);
}
void QueryTileFloat(const GpFactor32& f, int n_lanes, const double* x, void* scratch, double* mean,
                    double* variance) {
  QueryTile(f, n_lanes, x, static_cast<float*>(scratch), mean, variance);
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(QueryTileDouble);
HWY_EXPORT(QueryTileFloat);

std::size_t GpQueryScratchBytes(const GpFactor& f) {
  return sizeof(double) * kTileLanes * (f.dim + f.n_padded + kChunkRows + 2);
}
std::size_t GpQueryScratchBytes(const GpFactor32& f) {
  return sizeof(float) * kTileLanes * (f.dim + f.n_padded + kChunkRows + 2);
}

void GpQueryTile(const GpFactor& factor, int n_lanes, const double* x, void* scratch, double* mean,
                 double* variance) {
  HWY_DYNAMIC_DISPATCH(QueryTileDouble)(factor, n_lanes, x, scratch, mean, variance);
}
void GpQueryTile(const GpFactor32& factor, int n_lanes, const double* x, void* scratch,
                 double* mean, double* variance) {
  HWY_DYNAMIC_DISPATCH(QueryTileFloat)(factor, n_lanes, x, scratch, mean, variance);
}

}  // namespace downpour
#endif  // HWY_ONCE
