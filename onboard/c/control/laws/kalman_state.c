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
