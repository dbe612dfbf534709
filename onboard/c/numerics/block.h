/* A vector of floats as whole numbers with a common unit, and products of two of them in 64 bits: on a processor without
 * floating-point unit a product takes a tenth of the time. A number is exact to 2^-27 of the vector's largest one. */
#ifndef DMRAC_BLOCK_H
#define DMRAC_BLOCK_H

#include <stdint.h>

#include "numerics/real.h"

/* Of the largest number. Sums of 512 products fit into 64 bits. */
#define BLOCK_BITS 27

/* Bring `count` numbers of x, `stride` apart, to whole numbers; x_i = numbers[i] unit. Returns the unit: NaN unless all are
 * finite. Numbers below 1e-30 count as zero. */
real block_of(const real *x, int32_t count, int32_t stride, int32_t *numbers);

/* The whole number nearest to x 2^bits, halves away from zero; the largest one, with the sign, where it does not fit and for NaN.
 */
int32_t nearest_whole(real x, int32_t bits);

/* The sum of a_i b_i. */
int64_t block_dot(const int32_t *a, const int32_t *b, int32_t count);

/* The same of three, times both units, exact to 2^-26 of the largest product. */
real block_product(const int32_t a[3], real unit_a, const int32_t b[3], real unit_b);

#endif
