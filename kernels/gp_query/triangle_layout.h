// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace downpour {

// Order of a packed lower triangle in memory: the order in which GpQueryTile reads it. Bands of
// kChunkRows rows are cut into chunks of kChunkColumns columns, where the last one, up to the
// diagonal, takes up to kChunkRows more (1 % at n = 320), a chunk into panels of kRowBlock rows. A
// panel holds its columns up to its last row, column by column, kRowBlock values each.
inline constexpr int kRowBlock = 8;
// What three vectors of lanes need beside a chunk (128 x 24 doubles) stays in the first-level cache
// for all of its panels. The chunk that is fetched ahead must outlive the one that is read in the
// second: 256 rows cost 7 % at n = 2560.
inline constexpr int kChunkRows = 64;
inline constexpr int kChunkColumns = 128;

// Where value k of `width` of a point lies: values of kRowBlock points side by side, so that a
// vector can hold either many queries of one point or many points of one query.
inline constexpr std::size_t PointOffset(int point, int k, int width) {
  return (static_cast<std::size_t>(point / kRowBlock) * width + k) * kRowBlock + point % kRowBlock;
}

struct TriangleChunk {
  std::size_t offset;  // of its first panel
  std::size_t size;    // elements
  int row, end_row;    // multiples of kRowBlock
  int column, end_column;

  // Columns of the panel whose first row is `panel_row`.
  int Columns(int panel_row) const {
    const int end = panel_row + kRowBlock;
    return (end < end_column ? end : end_column) - column;
  }
};

// Calls body(chunk) for the chunks of an n x n triangle in order; n is a multiple of kRowBlock.
template <typename Body>
inline void ForEachChunk(int n, const Body& body) {
  std::size_t offset = 0;
  for (int band = 0; band < n; band += kChunkRows) {
    const int end_row = band + kChunkRows < n ? band + kChunkRows : n;
    for (int column = 0, end_column; column < end_row; column = end_column) {
      const bool last = end_row - column <= kChunkColumns + kChunkRows;
      end_column = last ? end_row : column + kChunkColumns;
      TriangleChunk chunk{offset, 0, band, end_row, column, end_column};
      for (int row = band; row < end_row; row += kRowBlock) {
        chunk.size += static_cast<std::size_t>(kRowBlock) * chunk.Columns(row);
      }
      body(chunk);
      offset += chunk.size;
    }
  }
}

}  // namespace downpour
