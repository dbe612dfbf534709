/* Dense matrices, row by row, in arrays of the caller. */
#ifndef DMRAC_SMALL_MATRIX_H
#define DMRAC_SMALL_MATRIX_H

#include <stdbool.h>

#include "numerics/real.h"

/* a . b over `count` numbers. */
real dot(const real *a, const real *b, int count);

/* sqrt(a . a) */
real norm(const real *a, int count);

/* out [n, n] = A A', A [n, columns]; symmetric to the last bit. A row begins `stride` numbers after the one before. */
void gram(const real *A, int n, int columns, int stride, real *out);

/* S [n, n], symmetric and positive definite, becomes its Cholesky factor, in the lower triangle. Returns false, with S not
 * to be used, if a pivot is not positive. */
bool cholesky_factor(real *S, int n);

/* B [n, columns] becomes X of S X = B, with the factor of S. */
void cholesky_substitute(const real *factor, real *B, int n, int columns);

/* Solve S X = B in place: S [n, n], symmetric and positive definite, becomes its Cholesky factor; B [n, columns] becomes
 * X. Returns false, with X not to be used, if a pivot is not positive. */
bool cholesky_solve(real *S, real *B, int n, int columns);

/* The largest singular value of A [rows, columns], rows `stride` apart. `work`: 2 n^2 numbers, n the smaller of rows and
 * columns. The time is bounded: a fixed number of products of n x n. */
real largest_singular_value(const real *A, int rows, int columns, int stride, real *work);

#endif
