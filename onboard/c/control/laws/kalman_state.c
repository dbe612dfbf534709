#include "control/laws/kalman_state.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

#ifdef DMRAC_WHOLE_COVARIANCE

#define ONE ((int32_t)1 << 30) /* 1 in S */
#define COLUMN_BITS 24         /* fractional bits of a column, in units of its size and the largest root */
#define PRODUCT_BITS 27        /* that a sum has more than what is used of it */
#define PRODUCT_UNIT REAL(7.450580596923828125e-09) /* 2^-27 */
#define ROOT_BITS 29                                /* fractional bits of u, over its root */
#define SQUARE_BITS 28                              /* that a square of it has more than S */
#define HALF ((int64_t)1 << (SQUARE_BITS - 1))

#define COLUMN_MOST UINT32_C(0x4c800000) /* 2^26 in float */
#define SQUARE_MOST UINT32_C(0x4e004000) /* 2^29 (1 + 2^-9) in float */

/* Whether x is at most so large in size, and not NaN: a comparison of bits takes a tenth of the time of one in float. */
static bool is_sensible(real x, uint32_t most) {
    float single = (float)x;
    uint32_t bits;
    memcpy(&bits, &single, sizeof bits);
    return (bits & UINT32_C(0x7fffffff)) <= most;
}

static void set_start(KalmanState *self, int32_t i) {
    bool again = i > 0 && self->prior_variance[i] == self->prior_variance[i - 1];
    self->root[i] = again ? self->root[i - 1] : real_sqrt(self->prior_variance[i]);
    self->inverse[i] = again ? self->inverse[i - 1] : (real)(1 << ROOT_BITS) / self->root[i];
    self->S[i * self->size + i] = ONE;
}

/* Units of products, once all roots are known. */
static void finish_start(KalmanState *self) {
    real largest = REAL(0.0);
    for (int32_t i = 0; i < self->size; i++) {
        largest = real_max(largest, self->root[i]);
    }
    for (int32_t i = 0; i < self->size; i++) {
        self->to_whole[i] = self->root[i] * ((real)(1 << COLUMN_BITS) / largest);
        self->of_whole[i] = self->root[i] * (largest * PRODUCT_UNIT);
    }
}

static void take_loss(KalmanState *self, int32_t i) {
    real loss = -real_expm1(-self->rates[i] * self->dt);
    self->loss[i] = loss < REAL(1.0) ? (int32_t)(loss * REAL(2147483648.0)) : INT32_MAX;
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
    real scale = REAL(1.0) / most;
    for (int32_t j = 0; j < count; j++) {
        real x = column[j] * self->to_whole[j];
        x = most == REAL(1.0) ? x : x * scale;
        whole[j] = is_sensible(x, COLUMN_MOST) ? (int32_t)x : 0;
    }
    for (int32_t i = 0; i < n; i++) {
        const int32_t *row = self->S + i * n, *other = whole;
        int64_t sum = 0;
        int32_t left = count;
        for (; left >= 4; left -= 4, row += 4, other += 4) {
            sum += (int64_t)row[0] * other[0];
            sum += (int64_t)row[1] * other[1];
            sum += (int64_t)row[2] * other[2];
            sum += (int64_t)row[3] * other[3];
        }
        for (; left > 0; left--) {
            sum += (int64_t)*row++ * *other++;
        }
        g[i] = (real)(int32_t)(sum >> PRODUCT_BITS) * self->of_whole[i];
        g[i] = most == REAL(1.0) ? g[i] : g[i] * most;
    }
}

/* S <- S - u u' */
static void subtract_square(KalmanState *self, const real *u) {
    int32_t whole[STATES_MAX], n = self->size;
    for (int32_t i = 0; i < n; i++) {
        real x = u[i] * self->inverse[i];
        bool sensible = is_sensible(x, SQUARE_MOST);
        self->broken = self->broken || !sensible;
        whole[i] = sensible ? (int32_t)x : 0;
    }
    for (int32_t i = 0; i < n; i++) {
        int64_t own = whole[i];
        for (int32_t j = 0; j <= i; j++) {
            int32_t change = (int32_t)((own * whole[j] + HALF) >> SQUARE_BITS);
            self->S[i * n + j] = self->S[j * n + i] = self->S[i * n + j] - change;
        }
    }
}

#else

static void set_start(KalmanState *self, int32_t i) {
    self->S[i * self->size + i] = self->prior_variance[i];
}

static void finish_start(KalmanState *self) {
    (void)self;
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

/* NOLINTNEXTLINE(readability-non-const-parameter): the packed form writes into it. */
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

static void start_whole(KalmanState *self) {
#ifdef DMRAC_WHOLE_COVARIANCE
    memset(self->loss, 0, sizeof self->loss);
    self->broken = false;
#else
    (void)self;
#endif
}

/* KalmanState.__init__ */
void kalman_state_init(KalmanState *self, const real *prior_variance, const real *rates, int32_t size) {
    self->size = size;
    self->dt = REAL(0.0);
    memset(self->X, 0, (size_t)(3 * size) * sizeof(real));
    memset(self->S, 0, (size_t)(size * size) * sizeof(covariance));
    start_whole(self);
    for (int i = 0; i < size; i++) {
        self->prior_variance[i] = prior_variance[i];
        self->rates[i] = rates[i];
        set_start(self, i);
        self->keep[i] = REAL(1.0); /* dt = 0 */
    }
    finish_start(self);
}

/* d of a state whose rate is that of the state before. */
static void copy_rate(KalmanState *self, int32_t i) {
    self->keep[i] = self->keep[i - 1];
#ifdef DMRAC_WHOLE_COVARIANCE
    self->loss[i] = self->loss[i - 1];
#endif
}

static void take_dt(KalmanState *self, real dt) {
    real share = REAL(0.0); /* 1 - d^2 */
    self->dt = dt;
    for (int i = 0; i < self->size; i++) {
        if (i > 0 && self->rates[i] == self->rates[i - 1]) {
            copy_rate(self, i);
        } else {
            self->keep[i] = real_exp(-self->rates[i] * dt);
            share = -real_expm1(REAL(-2.0) * self->rates[i] * dt);
            take_loss(self, i);
        }
        self->gain[i] = share * self->prior_variance[i];
    }
}

/* KalmanState.predict */
void kalman_state_predict(KalmanState *self, real dt) {
    if (dt != self->dt) {
        take_dt(self, dt);
    }
    for (int32_t i = 0; i < self->size; i++) {
        real d = self->keep[i];
        bool reverts = d != REAL(1.0);
        for (int axis = 0; reverts && axis < 3; axis++) {
            self->X[3 * i + axis] *= d;
        }
        predict_row(self, i);
    }
}

void kalman_state_copy(KalmanState *self, const KalmanState *from) {
    size_t n = (size_t)from->size;
    kalman_state_init(self, from->prior_variance, from->rates, from->size);
    memcpy(self->X, from->X, 3 * n * sizeof(real));
    memcpy(self->S, from->S, n * n * sizeof(covariance));
#ifdef DMRAC_WHOLE_COVARIANCE
    self->broken = from->broken;
#endif
}

/* KalmanState.along */
void kalman_state_along(const KalmanState *self, const real *column, int32_t count, real *g, real x[3]) {
    kalman_state_product(self, column, count, REAL(1.0), g);
    weighted(self->X, column, count, x);
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
