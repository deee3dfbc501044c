// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <new>
#include <vector>

namespace downpour {

// Lanes a tile holds at most: three AVX-512 vectors of float, or two times three of double; three
// vectors with eight rows of accumulators fill the register file. Every tile array is
// [variable][kTileLanes], row = variable, column = lane, rows kAlignment-aligned.
inline constexpr int kTileLanes = 48;
inline constexpr std::size_t kAlignment = 64;

// Allocator for arrays that kernels read with aligned vector loads.
template <typename T>
struct AlignedAllocator {
  using value_type = T;
  AlignedAllocator() = default;
  template <typename U>
  AlignedAllocator(const AlignedAllocator<U>&) {}
  T* allocate(std::size_t n) {
    return static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(kAlignment)));
  }
  void deallocate(T* p, std::size_t) { ::operator delete(p, std::align_val_t(kAlignment)); }
  bool operator==(const AlignedAllocator&) const { return true; }
};

template <typename T>
using AlignedVector = std::vector<T, AlignedAllocator<T>>;

}  // namespace downpour
