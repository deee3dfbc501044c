// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <omp.h>

// Fortran BLAS and LAPACK as OpenBLAS exports them: column-major, 32-bit integers. The hidden
// lengths of the one-letter strings are left out, as OpenBLAS allows.
extern "C" {
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
void dpotrs_(const char* uplo, const int* n, const int* nrhs, const double* a, const int* lda,
             double* b, const int* ldb, int* info);
void dlauum_(const char* uplo, const int* n, double* a, const int* lda, int* info);
void dtrtri_(const char* uplo, const char* diag, const int* n, double* a, const int* lda,
             int* info);
void dtrmm_(const char* side, const char* uplo, const char* trans, const char* diag, const int* m,
            const int* n, const double* alpha, const double* a, const int* lda, double* b,
            const int* ldb);
void dsymm_(const char* side, const char* uplo, const int* m, const int* n, const double* alpha,
            const double* a, const int* lda, const double* b, const int* ldb, const double* beta,
            double* c, const int* ldc);
}

namespace downpour {

// Holds the calls of OpenBLAS (OpenMP build) that this thread makes to one thread, so that their
// bits are the same inside and outside of a parallel region. OpenBLAS asks omp_get_max_threads(),
// which belongs to the calling task: other threads see nothing of it.
class SingleThreadedBlas {
 public:
  SingleThreadedBlas() : threads_(omp_get_max_threads()) { omp_set_num_threads(1); }
  ~SingleThreadedBlas() { omp_set_num_threads(threads_); }
  SingleThreadedBlas(const SingleThreadedBlas&) = delete;
  SingleThreadedBlas& operator=(const SingleThreadedBlas&) = delete;

 private:
  int threads_;
};

}  // namespace downpour
