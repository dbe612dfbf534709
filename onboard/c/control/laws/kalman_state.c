#include "control/laws/kalman_state.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

/* KalmanState.__init__ */
void kalman_state_init(KalmanState *self, const real *prior_variance, const real *rates, int32_t size) {
    memset(self, 0, sizeof *self);
    self->size = size;
    for (int i = 0; i < size; i++) {
        self->prior_variance[i] = prior_variance[i];
        self->rates[i] = rates[i];
        self->S[i * size + i] = prior_variance[i];
        self->keep[i] = REAL(1.0); /* dt = 0 */
    }
}

static void take_dt(KalmanState *self, real dt) {
    self->dt = dt;
    for (int i = 0; i < self->size; i++) {
        self->keep[i] = real_exp(-self->rates[i] * dt);
        self->gain[i] = -real_expm1(REAL(-2.0) * self->rates[i] * dt) * self->prior_variance[i];
    }
}

/* KalmanState.predict */
void kalman_state_predict(KalmanState *self, real dt) {
    int n = self->size;
    if (dt != self->dt) {
        take_dt(self, dt);
    }
    for (int i = 0; i < n; i++) {
        real d = self->keep[i];
        for (int axis = 0; axis < 3; axis++) {
            self->X[3 * i + axis] *= d;
        }
        for (int j = 0; j < i; j++) {
            self->S[i * n + j] = self->S[j * n + i] = self->S[i * n + j] * (d * self->keep[j]);
        }
        self->S[i * n + i] = self->S[i * n + i] * (d * d) + self->gain[i];
    }
}

/* KalmanState.along */
void kalman_state_along(const KalmanState *self, const real *column, int32_t count, real *g, real x[3]) {
    for (int i = 0; i < self->size; i++) {
        g[i] = dot(self->S + i * self->size, column, count);
    }
    x[0] = x[1] = x[2] = REAL(0.0);
    for (int i = 0; i < count; i++) {
        for (int axis = 0; axis < 3; axis++) {
            x[axis] += self->X[3 * i + axis] * column[i];
        }
    }
}

/* KalmanState.correct */
void kalman_state_correct(KalmanState *self, const real *g, const real innovation[3], real v) {
    int n = self->size;
    real root = REAL(1.0) / real_sqrt(v);
    real u[STATES_MAX], y[3];
    for (int i = 0; i < n; i++) {
        u[i] = g[i] * root;
    }
    for (int axis = 0; axis < 3; axis++) {
        y[axis] = innovation[axis] * root;
    }
    for (int i = 0; i < n; i++) {
        for (int axis = 0; axis < 3; axis++) {
            self->X[3 * i + axis] += y[axis] * u[i];
        }
        for (int j = 0; j <= i; j++) {
            self->S[i * n + j] = self->S[j * n + i] = self->S[i * n + j] - u[i] * u[j];
        }
    }
}

/* Factor of I + mu S. */
static bool factor_of(const real *S, int32_t n, real mu, real *factor) {
    for (int i = 0; i < n * n; i++) {
        factor[i] = mu * S[i];
    }
    for (int i = 0; i < n; i++) {
        factor[i * n + i] += REAL(1.0);
    }
    return cholesky_factor(factor, n);
}

/* tr(Y'S Z) of Y, Z [n, columns]. */
static real trace_along(const real *S, const real *Y, const real *Z, int32_t n, int32_t columns) {
    real sum = REAL(0.0);
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            sum += S[i * n + j] * dot(Y + columns * i, Z + columns * j, columns);
        }
    }
    return sum;
}

/* multiplier: Newton's method on 1 / norm. In place of the axes of S: Y = (I + mu S)^-1 X, Z = (I + mu S)^-1 Y, and the
 * slope of 1 / norm(Y) is tr(Y'S Z) / norm(Y)^3. */
real multiplier(const real *S, const real *X, int32_t n, int32_t columns, real radius, real *Y, real *work) {
    real Z[STATES_MAX * 3];
    size_t size = (size_t)(columns * n) * sizeof(real);
    real mu = REAL(0.0), next = REAL(0.0);
    memcpy(Y, X, size);
    for (int step = 0; factor_of(S, n, next, work); step++) {
        mu = next;
        memcpy(Y, X, size);
        cholesky_substitute(work, Y, n, columns);
        real norm2 = dot(Y, Y, columns * n);
        if (step == MULTIPLIER_STEPS || !(norm2 > (REAL(1.0) + MULTIPLIER_TOLERANCE) * radius * radius)) {
            break;
        }
        memcpy(Z, Y, size);
        cholesky_substitute(work, Z, n, columns);
        real length = real_sqrt(norm2);
        real slope = trace_along(S, Y, Z, n, columns) / (norm2 * length);
        if (!(slope > REAL(0.0))) {
            break;
        }
        next = mu + (REAL(1.0) / radius - REAL(1.0) / length) / slope;
    }
    return mu;
}
