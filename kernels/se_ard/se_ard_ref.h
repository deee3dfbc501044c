// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>

namespace downpour {

// SeArdCovarianceLower (kernels/se_ard/se_ard.h) in long double, entry by entry.
inline void SeArdCovarianceLowerRef(int n, int dim, const double* scaled, int ld,
                                    double signal_variance, long double* k, int ldk) {
  for (int j = 0; j < n; ++j) {
    for (int i = j; i < n; ++i) {
      long double distance = 0;
      for (int d = 0; d < dim; ++d) {
        const double* x = scaled + static_cast<std::size_t>(d) * ld;
        const long double delta = static_cast<long double>(x[i]) - x[j];
        distance += delta * delta;
      }
      k[static_cast<std::size_t>(j) * ldk + i] = signal_variance * std::exp(-0.5L * distance);
    }
  }
}

}  // namespace downpour
