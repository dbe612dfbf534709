#include "control/laws/kalman_state.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

#ifdef DMRAC_WHOLE_COVARIANCE

#define ONE ((int32_t)1 << 30)     /* 1 in S */
#define COLUMN_BITS 24             /* fractional bits of a column, in units of its size and the largest root */
#define PRODUCT_BITS 27            /* that a sum has more than what is used of it */
#define PRODUCT_UNIT REAL(7.450580596923828125e-09) /* 2^-27 */

/* x in whole numbers of at most `most`; 0, and `broken`, if it is larger or NaN. */
static int32_t whole_of(KalmanState *self, real x, real most) {
    if (x <= most && x >= -most) {
        return (int32_t)(x < REAL(0.0) ? x - REAL(0.5) : x + REAL(0.5));
    }
    self->broken = true;
    return 0;
}

static void set_start(KalmanState *self, int32_t i) {
    self->root[i] = real_sqrt(self->prior_variance[i]);
    self->inverse[i] = REAL(1.0) / self->root[i];
    self->largest = real_max(self->largest, self->root[i]);
    self->S[i * self->size + i] = ONE;
}

static void take_loss(KalmanState *self, int32_t i) {
    self->loss[i] = whole_of(self, -real_expm1(-self->rates[i] * self->dt) * REAL(2147483648.0), REAL(2147483520.0));
}

/* x - x loss, the loss with 31 fractional bits. */
static int32_t less(int32_t x, int32_t loss) {
    return x - (int32_t)(((int64_t)x * loss + ONE) >> 31);
}

/* The part of S of a prediction, row i. */
static void predict_row(KalmanState *self, int32_t i) {
    int32_t n = self->size, loss_i = self->loss[i], last = 0, loss = loss_i;
    for (int32_t j = 0; j < i; j++) {
        if (self->loss[j] != last) {
            last = self->loss[j];
            loss = loss_i + last - (int32_t)(((int64_t)loss_i * last) >> 31);
        }
        if (loss != 0) {
            self->S[i * n + j] = self->S[j * n + i] = less(self->S[i * n + j], loss);
        }
    }
    loss = 2 * loss_i - (int32_t)(((int64_t)loss_i * loss_i) >> 31);
    self->S[i * n + i] = ONE - less(ONE - self->S[i * n + i], loss);
}

bool kalman_state_is_finite(const KalmanState *self) {
    return !self->broken;
}

const real *kalman_state_dense(const KalmanState *self, real *space) {
    int32_t n = self->size;
    for (int32_t i = 0; i < n; i++) {
        kalman_state_column(self, i, space + i * n);
    }
    return space;
}

void kalman_state_column(const KalmanState *self, int32_t column, real *out) {
    real unit = self->root[column] * REAL(9.31322574615478515625e-10); /* 2^-30 */
    for (int32_t i = 0; i < self->size; i++) {
        out[i] = (real)self->S[column * self->size + i] * (self->root[i] * unit);
    }
}

void kalman_state_product(const KalmanState *self, const real *column, int32_t count, real most, real *g) {
    int32_t whole[STATES_MAX], n = self->size;
    real scale = (real)(1 << COLUMN_BITS) / (most * self->largest), unit = self->largest * most * PRODUCT_UNIT;
    for (int32_t j = 0; j < count; j++) {
        real x = column[j] * (self->root[j] * scale);
        bool sensible = x <= REAL(2.0) * (real)(1 << COLUMN_BITS) && x >= -REAL(2.0) * (real)(1 << COLUMN_BITS);
        whole[j] = sensible ? (int32_t)(x < REAL(0.0) ? x - REAL(0.5) : x + REAL(0.5)) : 0;
    }
    for (int32_t i = 0; i < n; i++) {
        const int32_t *row = self->S + i * n;
        int64_t sum = 0;
        for (int32_t j = 0; j < count; j++) {
            sum += (int64_t)row[j] * whole[j];
        }
        g[i] = (real)(int32_t)(sum >> PRODUCT_BITS) * (self->root[i] * unit);
    }
}

/* S <- S - u u' */
static void subtract_square(KalmanState *self, const real *u) {
    int32_t whole[STATES_MAX], n = self->size;
    for (int32_t i = 0; i < n; i++) {
        whole[i] = whole_of(self, u[i] * self->inverse[i] * (real)ONE, REAL(1.001) * (real)ONE);
    }
    for (int32_t i = 0; i < n; i++) {
        int64_t own = whole[i];
        for (int32_t j = 0; j <= i; j++) {
            int32_t change = (int32_t)((own * whole[j] + (ONE >> 1)) >> 30);
            self->S[i * n + j] = self->S[j * n + i] = self->S[i * n + j] - change;
        }
    }
}

#else

static void set_start(KalmanState *self, int32_t i) {
    self->S[i * self->size + i] = self->prior_variance[i];
}

static void take_loss(KalmanState *self, int32_t i) {
    (void)self; /* keep and gain say it */
    (void)i;
}

/* The part of S of a prediction, row i. */
static void predict_row(KalmanState *self, int32_t i) {
    int32_t n = self->size;
    real d = self->keep[i];
    for (int32_t j = 0; j < i; j++) {
        self->S[i * n + j] = self->S[j * n + i] = self->S[i * n + j] * (d * self->keep[j]);
    }
    self->S[i * n + i] = self->S[i * n + i] * (d * d) + self->gain[i];
}

bool kalman_state_is_finite(const KalmanState *self) {
    for (int i = 0; i < self->size * self->size; i++) {
        if (!real_is_finite(self->S[i])) {
            return false;
        }
    }
    return true;
}

const real *kalman_state_dense(const KalmanState *self, real *space) {
    (void)space;
    return self->S;
}

void kalman_state_column(const KalmanState *self, int32_t column, real *out) {
    memcpy(out, self->S + column * self->size, (size_t)self->size * sizeof(real));
}

void kalman_state_product(const KalmanState *self, const real *column, int32_t count, real most, real *g) {
    (void)most;
    for (int i = 0; i < self->size; i++) {
        g[i] = dot(self->S + i * self->size, column, count);
    }
}

/* S <- S - u u' */
static void subtract_square(KalmanState *self, const real *u) {
    int n = self->size;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            self->S[i * n + j] = self->S[j * n + i] = self->S[i * n + j] - u[i] * u[j];
        }
    }
}

#endif

/* KalmanState.__init__ */
void kalman_state_init(KalmanState *self, const real *prior_variance, const real *rates, int32_t size) {
    memset(self, 0, sizeof *self);
    self->size = size;
    for (int i = 0; i < size; i++) {
        self->prior_variance[i] = prior_variance[i];
        self->rates[i] = rates[i];
        set_start(self, i);
        self->keep[i] = REAL(1.0); /* dt = 0 */
    }
}

static void take_dt(KalmanState *self, real dt) {
    self->dt = dt;
    for (int i = 0; i < self->size; i++) {
        self->keep[i] = real_exp(-self->rates[i] * dt);
        self->gain[i] = -real_expm1(REAL(-2.0) * self->rates[i] * dt) * self->prior_variance[i];
        take_loss(self, i);
    }
}

/* KalmanState.predict */
void kalman_state_predict(KalmanState *self, real dt) {
    if (dt != self->dt) {
        take_dt(self, dt);
    }
    for (int32_t i = 0; i < self->size; i++) {
        real d = self->keep[i];
        for (int axis = 0; d != REAL(1.0) && axis < 3; axis++) {
            self->X[3 * i + axis] *= d;
        }
        predict_row(self, i);
    }
}

/* KalmanState.along */
void kalman_state_along(const KalmanState *self, const real *column, int32_t count, real *g, real x[3]) {
    kalman_state_product(self, column, count, REAL(1.0), g);
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
    }
    subtract_square(self, u);
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
