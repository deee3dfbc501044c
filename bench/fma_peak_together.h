// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace downpour {

// GFLOP/s of the fp64 multiply-add peak of `threads` threads at once, in a tenth of a second.
double FmaPeakTogether(int threads);

}  // namespace downpour
