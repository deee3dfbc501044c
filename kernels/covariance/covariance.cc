// SPDX-License-Identifier: Apache-2.0
#include "kernels/covariance/covariance.h"

#include <algorithm>
#include <cstddef>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/covariance/covariance.cc"
#include "hwy/foreach_target.h"  // IWYU pragma: keep
// After foreach_target:
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace downpour {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;

// A block of the output, three vectors of rows by as many columns as registers allow, is summed up
// in registers: 24 of 32 accumulate, or 12 of 16.
constexpr int kVectors = 3;
constexpr int kColumns = HWY_TARGET <= HWY_AVX3 ? 8 : 4;

// Rows of a block that exist, up to kVectors vectors.
class Rows {
 public:
  explicit Rows(std::ptrdiff_t n) {
    for (int v = 0; v < kVectors; ++v) {
      count_[v] = std::clamp<std::ptrdiff_t>(n - v * Lanes(), 0, Lanes());
#if HWY_TARGET <= HWY_AVX2
      mask_[v] = hn::FirstN(D(), count_[v]);
#endif
    }
  }

#if HWY_TARGET <= HWY_AVX2
  V Load(int v, const double* p) const { return hn::MaskedLoad(mask_[v], D(), p + v * Lanes()); }
  void Store(int v, V value, double* p) const {
    hn::BlendedStore(value, mask_[v], D(), p + v * Lanes());
  }
#else  // masked loads want alignment there, or touch what they leave out
  V Load(int v, const double* p) const {
    if (count_[v] == Lanes()) return hn::LoadU(D(), p + v * Lanes());
    HWY_ALIGN double part[hn::MaxLanes(D())] = {};
    std::copy_n(p + v * Lanes(), count_[v], part);
    return hn::Load(D(), part);
  }
  void Store(int v, V value, double* p) const {
    if (count_[v] == Lanes()) return hn::StoreU(value, D(), p + v * Lanes());
    HWY_ALIGN double part[hn::MaxLanes(D())];
    hn::Store(value, D(), part);
    std::copy_n(part, count_[v], p + v * Lanes());
  }
#endif

 private:
  static std::ptrdiff_t Lanes() { return static_cast<std::ptrdiff_t>(hn::Lanes(D())); }

  std::ptrdiff_t count_[kVectors];
#if HWY_TARGET <= HWY_AVX2
  hn::Mask<D> mask_[kVectors];
#endif
};

// Second operand: element k of column j is at first[k * step + j * column].
struct Operand {
  const double* first;
  std::ptrdiff_t step, column;
};

// out = sum over k < n_terms of a[k] b[k], where a[k] is the column at a + k n and `columns` <=
// kColumns of the block exist; kUpdate: out = decay out + sum of weights[k] a[k] b[k].
template <bool kUpdate>
HWY_INLINE void UpdateBlock(std::ptrdiff_t n, const Rows& rows, int columns, double decay,
                            std::ptrdiff_t n_terms, const double* weights, const double* a,
                            const Operand& b, double* out) {
  const D d;
  V sum[kVectors][kColumns];
  std::ptrdiff_t at[kColumns];  // columns that do not exist repeat the last
  for (int j = 0; j < kColumns; ++j) at[j] = std::min(j, columns - 1);
  for (int v = 0; v < kVectors; ++v) {
    for (int j = 0; j < kColumns; ++j) {
      sum[v][j] = kUpdate ? hn::Mul(hn::Set(d, decay), rows.Load(v, out + at[j] * n)) : hn::Zero(d);
    }
  }
  for (int j = 0; j < kColumns; ++j) at[j] *= b.column;
  for (std::ptrdiff_t k = 0; k < n_terms; ++k) {
    V left[kVectors];
    for (int v = 0; v < kVectors; ++v) {
      left[v] = rows.Load(v, a + k * n);
      if constexpr (kUpdate) left[v] = hn::Mul(left[v], hn::Set(d, weights[k]));
    }
    for (int j = 0; j < kColumns; ++j) {
      const V right = hn::Set(d, b.first[k * b.step + at[j]]);
      for (int v = 0; v < kVectors; ++v) sum[v][j] = hn::MulAdd(left[v], right, sum[v][j]);
    }
  }
  for (int j = 0; j < kColumns; ++j) {  // a constant bound keeps the sums in registers
    if (j >= columns) break;
    for (int v = 0; v < kVectors; ++v) rows.Store(v, sum[v][j], out + j * n);
  }
}

void Triangular(int size, int m, const double* l, const double* z, double* y) {
  const std::ptrdiff_t n = size, height = kVectors * hn::Lanes(D());
  for (std::ptrdiff_t row = 0; row < n; row += height) {
    const Rows rows(n - row);
    // Beyond the block's last row L is zero.
    const std::ptrdiff_t n_terms = std::min(row + height, n);
    for (int column = 0; column < m; column += kColumns) {
      UpdateBlock<false>(n, rows, std::min(kColumns, m - column), 0, n_terms, nullptr, l + row,
                         {z + column * n, 1, n}, y + row + column * n);
    }
  }
}

void Symmetric(int size, int k, double decay, const double* weights, const double* a, double* c) {
  const std::ptrdiff_t n = size, height = kVectors * hn::Lanes(D());
  for (std::ptrdiff_t row = 0; row < n; row += height) {
    const Rows rows(n - row);
    const auto end = static_cast<int>(std::min(row + height, n));
    const double* const a_row = k > 0 ? a + row : a;  // without columns A may be nullptr
    for (int column = 0; column < end; column += kColumns) {
      const double* const a_column = k > 0 ? a + column : a;
      UpdateBlock<true>(n, rows, std::min(kColumns, end - column), decay, k, weights, a_row,
                        {a_column, n, 1}, c + row + column * n);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace downpour
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace downpour {

HWY_EXPORT(Triangular);
HWY_EXPORT(Symmetric);

void TriangularProduct(int n, int m, const double* l, const double* z, double* y) {
  HWY_DYNAMIC_DISPATCH(Triangular)(n, m, l, z, y);
}

void SymmetricProduct(int n, int k, double decay, const double* weights, const double* a,
                      double* c) {
  HWY_DYNAMIC_DISPATCH(Symmetric)(n, k, decay, weights, a, c);
}

}  // namespace downpour
#endif  // HWY_ONCE
