// SPDX-License-Identifier: Apache-2.0
#pragma once

// Fortran BLAS and LAPACK as OpenBLAS exports them: column-major, 32-bit integers. The hidden
// lengths of the one-letter strings are left out, as OpenBLAS allows.
extern "C" {
void dsyevd_(const char* jobz, const char* uplo, const int* n, double* a, const int* lda, double* w,
             double* work, const int* lwork, int* iwork, const int* liwork, int* info);
void dsyrk_(const char* uplo, const char* trans, const int* n, const int* k, const double* alpha,
            const double* a, const int* lda, const double* beta, double* c, const int* ldc);
void dsymm_(const char* side, const char* uplo, const int* m, const int* n, const double* alpha,
            const double* a, const int* lda, const double* b, const int* ldb, const double* beta,
            double* c, const int* ldc);
}
