// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "kernels/aligned.h"

namespace downpour {

// What a GP query takes besides matrix products (engine/gp/blas_query.h): the covariances before
// them and the variances after them. n_queries is a multiple of kTileLanes; matrices have a row of
// n_queries contiguous elements a point, that is, they are n_queries x n column-major; those, and
// `variance`, are aligned. No argument may alias another. Thread-safe, do not allocate.

// e[i n_queries + q] = 2^-sum_d (queries[d n_queries + q] - points[i dim + d])^2, the SE-ARD
// covariance (paper Eq. 6) over signal_variance for inputs times s_d = sqrt(log2(e)/2)/l_d.
//   queries  dim rows of n_queries; points n x dim row-major; e n rows of n_queries
// Relative error of an entry <= (dim + 4) eps (1 + its exponent), eps of the type; exactly 1 at
// distance 0, exactly 0 below the normal numbers. A query that is not finite gives NaN for every
// point.
void QueryCovariances(int n_queries, int n, int dim, const double* queries, const double* points,
                      double* e);
void QueryCovariances(int n_queries, int n, int dim, const float* queries, const float* points,
                      float* e);

// variance[q] = signal_variance - sum_i v[i n_queries + q]^2, clamped to >= 0; NaN stays NaN.
//   v  n rows of n_queries
// Error <= (n + 2) eps (signal_variance + the sum).
void QueryVariances(int n_queries, int n, double signal_variance, const double* v,
                    double* variance);
void QueryVariances(int n_queries, int n, double signal_variance, const float* v, double* variance);

}  // namespace downpour
