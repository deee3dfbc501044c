// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace downpour {

// Solves y' = f(y) for y of N long doubles over `duration`, independently of MuJoCo: the modified
// midpoint rule with polynomial extrapolation in the squared step (Gragg-Bulirsch-Stoer; Hairer,
// Norsett, Wanner, Solving ODEs I, II.9) on n_pieces equal pieces. `*error` becomes the sum over
// the pieces of the largest difference between the last two extrapolations.
template <std::size_t N, typename Derivative>
std::array<long double, N> SolveOde(const Derivative& f, std::array<long double, N> y,
                                    long double duration, int n_pieces, long double* error) {
  using Vector = std::array<long double, N>;
  constexpr int kColumns = 9;
  const auto combine = [](const Vector& a, long double factor, const Vector& b) {
    Vector sum;
    for (std::size_t i = 0; i < N; ++i) sum[i] = a[i] + factor * b[i];
    return sum;
  };
  const long double piece = duration / n_pieces;
  *error = 0;
  for (int p = 0; p < n_pieces; ++p) {
    std::array<Vector, kColumns> row{};  // row[k]: T(j, k) of the extrapolation table
    long double change = 0;
    for (int j = 0; j < kColumns; ++j) {
      const int n = 2 * (j + 1);
      const long double h = piece / n;
      Vector before = y;
      Vector now = combine(y, h, f(y));
      for (int step = 1; step < n; ++step) {
        const Vector next = combine(before, 2 * h, f(now));
        before = now;
        now = next;
      }
      // Gragg's smoothing makes the error expansion even in h.
      Vector value = combine(combine(before, 1, now), h, f(now));
      for (long double& v : value) v /= 2;
      for (int k = 0; k < j; ++k) {
        const Vector previous = row[k];
        row[k] = value;
        const long double ratio = static_cast<long double>(n) / (2 * (j - k));
        const Vector difference = combine(value, -1, previous);
        value = combine(value, 1 / (ratio * ratio - 1), difference);
        if (j == kColumns - 1 && k == j - 1) {
          for (std::size_t i = 0; i < N; ++i) {
            change = std::fmax(change, std::fabs(value[i] - row[k][i]));
          }
        }
      }
      row[j] = value;
    }
    y = row[kColumns - 1];
    *error += change;
  }
  return y;
}

}  // namespace downpour
