/* Products of the last layer with features. In `real`; with -DDMRAC_WHOLE_COVARIANCE in whole numbers (numerics/block.h). */
#ifndef DMRAC_PRODUCTS_H
#define DMRAC_PRODUCTS_H

#include "control/features.h"

/* The features and the fast bias. */
#define STATES_MAX (FEATURES_MAX + 1)

/* A vector that takes part in several products. */
typedef struct {
#ifdef DMRAC_WHOLE_COVARIANCE
    int32_t numbers[STATES_MAX];
#else
    real numbers[STATES_MAX];
#endif
    real unit;
} Factor;

/* `count` numbers of x, `stride` apart. */
void factor_take(Factor *self, const real *x, int32_t count, int32_t stride);

/* The sum of a_i b_i over the first `count` numbers. */
real factor_dot(const Factor *a, const Factor *b, int32_t count);

/* The columns of W [k, 3]. */
void factors_take(Factor self[3], const real *W, int32_t k);

/* W'Phi */
void factors_times(const Factor W[3], const Factor *Phi, int32_t k, real out[3]);

/* W'Phi of W [k, 3] and Phi [k]. */
void weighted(const real *W, const real *Phi, int32_t k, real out[3]);

#endif
