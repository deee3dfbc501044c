// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/triangle.h"

#include <cstddef>

#include "engine/lapack.h"

namespace downpour {

//  [ A 0 ]^-1   [   A^-1           0   ]
//  [ C B ]    = [ -B^-1 C A^-1    B^-1 ]
void InvertLowerTriangle(int n, double* l, int ld) {
  constexpr int kSmallBlock = 16;
  if (n <= kSmallBlock) {
    int info = 0;
    dtrtri_("L", "N", &n, l, &ld, &info);
    return;
  }
  const int top = (n / 2 + 7) / 8 * 8, bottom = n - top;
  double* const c = l + top;
  double* const b = c + static_cast<std::size_t>(top) * ld;
  InvertLowerTriangle(top, l, ld);
  InvertLowerTriangle(bottom, b, ld);
  const double one = 1, minus_one = -1;
  dtrmm_("L", "L", "N", "N", &bottom, &top, &minus_one, b, &ld, c, &ld);
  dtrmm_("R", "L", "N", "N", &bottom, &top, &one, l, &ld, c, &ld);
}

}  // namespace downpour
