#include "numerics/small_matrix.h"

#include "numerics/elementary.h"

/* Squarings of the Gram matrix. Two singular values that differ by the relative d are told apart if d 2^SQUARINGS is
 * large; if it is not, either of them is right within 2^-SQUARINGS. */
#define SQUARINGS 26

real dot(const real *a, const real *b, int count) {
    real sum = REAL(0.0);
    for (int i = 0; i < count; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

real norm(const real *a, int count) {
    return real_sqrt(dot(a, a, count));
}

void gram(const real *A, int n, int columns, int stride, real *out) {
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            out[i * n + j] = out[j * n + i] = dot(A + i * stride, A + j * stride, columns);
        }
    }
}

/* S = L L' */
bool cholesky_factor(real *S, int n) {
    for (int j = 0; j < n; j++) {
        real pivot = S[j * n + j] - dot(S + j * n, S + j * n, j);
        if (!(pivot > REAL(0.0))) {
            return false;
        }
        real diagonal = real_sqrt(pivot);
        S[j * n + j] = diagonal;
        for (int i = j + 1; i < n; i++) {
            S[i * n + j] = (S[i * n + j] - dot(S + i * n, S + j * n, j)) / diagonal;
        }
    }
    return true;
}

void cholesky_substitute(const real *factor, real *B, int n, int columns) {
    for (int c = 0; c < columns; c++) {
        for (int i = 0; i < n; i++) { /* L y = b */
            real left = B[i * columns + c];
            for (int j = 0; j < i; j++) {
                left -= factor[i * n + j] * B[j * columns + c];
            }
            B[i * columns + c] = left / factor[i * n + i];
        }
        for (int i = n - 1; i >= 0; i--) { /* L' x = y */
            real left = B[i * columns + c];
            for (int j = i + 1; j < n; j++) {
                left -= factor[j * n + i] * B[j * columns + c];
            }
            B[i * columns + c] = left / factor[i * n + i];
        }
    }
}

bool cholesky_solve(real *S, real *B, int n, int columns) {
    if (!cholesky_factor(S, n)) {
        return false;
    }
    cholesky_substitute(S, B, n, columns);
    return true;
}

/* A A' or A' A, whichever is smaller. */
static void gram_of_shorter(const real *A, int rows, int columns, int stride, real *out) {
    if (rows <= columns) {
        gram(A, rows, columns, stride, out);
        return;
    }
    int n = columns;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            real sum = REAL(0.0);
            for (int k = 0; k < rows; k++) {
                sum += A[k * stride + i] * A[k * stride + j];
            }
            out[i * n + j] = out[j * n + i] = sum;
        }
    }
}

/* Divide by the trace, so that powers neither overflow nor vanish; returns the trace. */
static real normalise(real *S, int n) {
    real trace = REAL(0.0);
    for (int i = 0; i < n; i++) {
        trace += S[i * n + i];
    }
    for (int i = 0; trace > REAL(0.0) && i < n * n; i++) {
        S[i] /= trace;
    }
    return trace;
}

/* x' S x / x' x */
static real rayleigh_quotient(const real *S, const real *x, int n) {
    real above = REAL(0.0);
    for (int i = 0; i < n; i++) {
        above += x[i] * dot(S + i * n, x, n);
    }
    return above / dot(x, x, n);
}

/* S^(2^k) tends to v v', v the eigenvector of the largest eigenvalue; the Rayleigh quotient of v is that eigenvalue. */
real largest_singular_value(const real *A, int rows, int columns, int stride, real *work) {
    int n = rows < columns ? rows : columns;
    real *power = work, *next = work + n * n;
    gram_of_shorter(A, rows, columns, stride, power);
    real trace = normalise(power, n);
    if (!(trace > REAL(0.0)) || !real_is_finite(trace)) {
        return trace; /* a matrix of zeros, or one with a number that is not finite */
    }
    for (int k = 0; k < SQUARINGS; k++) {
        gram(power, n, n, n, next);
        normalise(next, n);
        real *kept = power;
        power = next;
        next = kept;
    }
    int best = 0;
    for (int i = 1; i < n; i++) {
        best = power[i * n + i] > power[best * n + best] ? i : best;
    }
    gram_of_shorter(A, rows, columns, stride, next);
    return real_sqrt(rayleigh_quotient(next, power + best * n, n));
}
