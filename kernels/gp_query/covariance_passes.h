// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "kernels/gp_query/gp_query.h"

namespace downpour {

// Passes of GpQueryTile over the covariances of a tile, in their order.
enum class CovariancePass { kDistances, kExponentials, kDeflation, kMean };

// For profiles: what GpQueryTile does for a full tile of queries without the variance, up to and
// including the pass `last`, which must be before kMean. The time of a pass is what it adds.
//   x        D x kTileLanes, aligned; scratch aligned, GpQueryScratchBytes
// Thread-safe, does not allocate.
void CovariancePasses(const GpFactor& factor, CovariancePass last, const double* x, void* scratch);
void CovariancePasses(const GpFactor32& factor, CovariancePass last, const double* x,
                      void* scratch);

// Additions, multiplications and halves of fused multiply-adds that a power takes, on the AVX-512
// targets; others take up to twice as many.
constexpr int ExponentialOperations(bool single_precision) { return single_precision ? 9 : 15; }

}  // namespace downpour
