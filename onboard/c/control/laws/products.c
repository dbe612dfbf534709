#include "control/laws/products.h"

#include "numerics/block.h"
#include "numerics/small_matrix.h"

#ifdef DMRAC_WHOLE_COVARIANCE

void factor_take(Factor *self, const real *x, int32_t count, int32_t stride) {
    self->unit = block_of(x, count, stride, self->numbers);
}

real factor_dot(const Factor *a, const Factor *b, int32_t count) {
    return (real)block_dot(a->numbers, b->numbers, count) * a->unit * b->unit;
}

#else

void factor_take(Factor *self, const real *x, int32_t count, int32_t stride) {
    self->unit = REAL(1.0);
    for (int32_t i = 0; i < count; i++) {
        self->numbers[i] = x[i * stride];
    }
}

real factor_dot(const Factor *a, const Factor *b, int32_t count) {
    return dot(a->numbers, b->numbers, count);
}

#endif

void factors_take(Factor self[3], const real *W, int32_t k) {
    for (int axis = 0; axis < 3; axis++) {
        factor_take(self + axis, W + axis, k, 3);
    }
}

void factors_times(const Factor W[3], const Factor *Phi, int32_t k, real out[3]) {
    for (int axis = 0; axis < 3; axis++) {
        out[axis] = factor_dot(W + axis, Phi, k);
    }
}

void weighted(const real *W, const real *Phi, int32_t k, real out[3]) {
    Factor columns[3], of_Phi;
    factors_take(columns, W, k);
    factor_take(&of_Phi, Phi, k, 1);
    factors_times(columns, &of_Phi, k, out);
}
