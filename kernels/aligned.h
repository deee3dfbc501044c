// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <new>
#include <vector>

namespace downpour {

// Lanes a tile holds at most: three AVX-512 vectors of float, or two times three of double; three
// vectors with eight rows of accumulators fill the register file. Every tile array is
// [variable][kTileLanes], row = variable, column = lane, rows kAlignment-aligned.
inline constexpr int kTileLanes = 48;
inline constexpr std::size_t kAlignment = 64;

// Allocator for arrays that kernels read with aligned vector loads. Large ones ask for huge pages:
// a triangle that streams from the third-level cache gains 3 to 5 %.
template <typename T>
struct AlignedAllocator {
  using value_type = T;
  AlignedAllocator() = default;
  template <typename U>
  AlignedAllocator(const AlignedAllocator<U>&) {}
  T* allocate(std::size_t n) {
    void* const p = ::operator new(n * sizeof(T), Alignment(n));
    if (Alignment(n) == std::align_val_t(kHugePage)) madvise(p, n * sizeof(T), MADV_HUGEPAGE);
    return static_cast<T*>(p);
  }
  void deallocate(T* p, std::size_t n) { ::operator delete(p, Alignment(n)); }
  bool operator==(const AlignedAllocator&) const { return true; }

 private:
  static constexpr std::size_t kHugePage = std::size_t{2} << 20;
  static std::align_val_t Alignment(std::size_t n) {
    return std::align_val_t(n * sizeof(T) >= 2 * kHugePage ? kHugePage : kAlignment);
  }
};

template <typename T>
using AlignedVector = std::vector<T, AlignedAllocator<T>>;

}  // namespace downpour
