#include "estimation/error_state_filter.h"

#include <string.h>

#include "numerics/block.h"
#include "numerics/elementary.h"
#include "numerics/small_matrix.h"
#include "protocol/geometry.h"

#define N ERROR_SIZE

/* ErrorStateFilter.__init__ */
void filter_init(ErrorStateFilter *self, int32_t covariance_every) {
    memset(self, 0, sizeof *self);
    self->every = covariance_every;
    self->quaternion[0] = REAL(1.0);
    rotation_of(self->quaternion, self->rotation);
    history_init(&self->history);
}

/* ErrorStateFilter.start */
void filter_start(ErrorStateFilter *self, const real quaternion[4], const real gyro_bias[3], const real sigmas[N]) {
    memcpy(self->quaternion, quaternion, sizeof self->quaternion);
    rotation_of(quaternion, self->rotation);
    vector_copy(gyro_bias, self->gyro_bias);
    memset(self->P, 0, sizeof self->P);
    for (int i = 0; i < N; i++) {
        self->P[i * N + i] = sigmas[i] * sigmas[i];
    }
}

/* ErrorStateFilter._rotate: omega = g + (delay / dt - 1/2) (g - g_before) - b_g;  q <- q exp(omega dt) */
static void rotate_by(ErrorStateFilter *self, real dt, const real gyroscope[3], real delay_s) {
    real ahead = delay_s / dt - REAL(0.5), turn[3], step[4];
    for (int i = 0; i < 3; i++) {
        real before = self->has_last_rate ? self->last_rate[i] : gyroscope[i];
        turn[i] = (gyroscope[i] + ahead * (gyroscope[i] - before) - self->gyro_bias[i]) * dt;
        self->last_rate[i] = gyroscope[i];
    }
    self->has_last_rate = true;
    quaternion_of_rotation_vector(turn, step);
    unit_product(self->quaternion, step, self->quaternion);
    rotation_of(self->quaternion, self->rotation);
}

/* ErrorStateFilter._move: dv = 1/2 (R_before + R) (accelerometer - b_a) dt + g dt
 * p <- p + (v + 1/2 dv) dt,  v <- v + dv */
static void move_by(ErrorStateFilter *self, real dt, const real accelerometer[3], const real R_before[9]) {
    real half = REAL(0.5) * dt, a[3], dv[3];
    for (int i = 0; i < 3; i++) {
        a[i] = (accelerometer[i] - self->accelerometer_bias[i]) * half;
    }
    for (int i = 0; i < 3; i++) {
        const real *R = self->rotation + 3 * i, *S = R_before + 3 * i;
        dv[i] = (R[0] + S[0]) * a[0] + (R[1] + S[1]) * a[1] + (R[2] + S[2]) * a[2];
    }
    dv[2] += GRAVITY * dt;
    for (int i = 0; i < 3; i++) {
        self->position[i] += (self->velocity[i] + REAL(0.5) * dv[i]) * dt;
        self->velocity[i] += dv[i];
        self->collected_dv[i] += dv[i];
    }
    self->collected_dv[2] -= GRAVITY * dt;
}

/* row[i] += sum_j M[i][j] other[j], with elements `step` apart: one line of a product with a block of the transition; of a
 * triangle only from the diagonal on */
static void add_block(const real M[9], real *P, int to, int from, int line, int element, bool triangle) {
    for (int i = 0; i < 3; i++) {
        int first = triangle ? to + i : 0;
        real *target = P + (to + i) * line;
        for (int j = 0; j < 3; j++) {
            const real *source = P + (from + j) * line;
            real m = M[3 * i + j];
            for (int k = m != REAL(0.0) ? first : N; k < N; k++) {
                target[k * element] += m * source[k * element];
            }
        }
    }
}

/* P <- Phi P, or the lower triangle of P <- P Phi^T with lines and elements exchanged. The order leaves what is still needed as
 * it was. */
static void multiply_transition(const real A[9], const real B[9], const real dt_I[9], real *P, int line, int element) {
    bool triangle = line < element;
    add_block(dt_I, P, POSITION, VELOCITY, line, element, triangle);
    add_block(A, P, VELOCITY, ATTITUDE, line, element, triangle);
    add_block(B, P, VELOCITY, ACCELEROMETER_BIAS, line, element, triangle);
    add_block(B, P, ATTITUDE, GYRO_BIAS, line, element, triangle);
}

/* The upper triangle is that below: an antisymmetric part would stay, and Phi lets it grow with t^6. */
static void make_symmetric(real P[N * N]) {
    for (int i = 1; i < N; i++) {
        for (int j = 0; j < i; j++) {
            P[j * N + i] = P[i * N + j];
        }
    }
}

/* ErrorStateFilter._predict_covariance: P <- Phi P Phi^T + Q over the collected samples. Phi differs from the identity in
 * four blocks only: dt I, A = -[f dt]x, and twice B = -R dt. */
static void predict_covariance(ErrorStateFilter *self, const ImuNoise *noise) {
    real dt = self->collected_s, sample_s = dt / (real)self->collected, zero = REAL(0.0);
    const real *f = self->collected_dv;
    const real A[9] = {zero, f[2], -f[1], -f[2], zero, f[0], f[1], -f[0], zero};
    const real dt_I[9] = {dt, zero, zero, zero, dt, zero, zero, zero, dt};
    real B[9];
    for (int i = 0; i < 9; i++) {
        B[i] = -dt * self->rotation[i];
    }
    multiply_transition(A, B, dt_I, self->P, N, 1);
    multiply_transition(A, B, dt_I, self->P, 1, N);
    const real Q[4] = {noise->accelerometer * noise->accelerometer * sample_s * dt,
                       noise->gyroscope * noise->gyroscope * sample_s * dt, noise->gyro_walk * noise->gyro_walk * dt,
                       noise->accelerometer_walk * noise->accelerometer_walk * dt};
    for (int i = VELOCITY; i < N; i++) {
        self->P[i * N + i] += Q[i / 3 - 1];
    }
    make_symmetric(self->P);
    self->collected = 0;
    self->collected_s = REAL(0.0);
    vector_zero(self->collected_dv);
}

/* ErrorStateFilter.predict */
void filter_predict(ErrorStateFilter *self, int64_t time_ns, real dt, const real accelerometer[3],
                    const real gyroscope[3], const ImuNoise *noise, real gyro_delay_s) {
    real R_before[9], rate[3];
    PastState state = {.time_ns = time_ns};
    memcpy(R_before, self->rotation, sizeof R_before);
    rotate_by(self, dt, gyroscope, gyro_delay_s);
    move_by(self, dt, accelerometer, R_before);
    vector_subtract(gyroscope, self->gyro_bias, rate);
    vector_copy(self->position, state.position);
    vector_copy(self->velocity, state.velocity);
    memcpy(state.rotation, self->rotation, sizeof state.rotation);
    matrix_times(self->rotation, rate, state.rate_world);
    history_append(&self->history, &state);
    self->collected_s += dt;
    self->collected++;
    if (self->collected >= self->every) {
        predict_covariance(self, noise);
    }
}

/* ErrorStateFilter.at */
bool filter_at(const ErrorStateFilter *self, int64_t time_ns, PastState *out) {
    return history_at(&self->history, time_ns, out);
}

/* ErrorStateFilter._apply */
static void apply(ErrorStateFilter *self, const real error[N]) {
    filter_shift(self, error + POSITION, error + VELOCITY, error + ATTITUDE);
    vector_add(self->gyro_bias, error + GYRO_BIAS, self->gyro_bias);
    vector_add(self->accelerometer_bias, error + ACCELEROMETER_BIAS, self->accelerometer_bias);
}

/* K = P h^T / S,  P <- P - K h P,  error = K innovation, if the score is within the gate */
static real correct_by(ErrorStateFilter *self, const real PHt[N], real S, real innovation, real gate) {
    real score = innovation * innovation / S, error[N];
    if (score <= gate) {
        for (int i = 0; i < N; i++) {
            real K = PHt[i] / S;
            for (int j = 0; j <= i; j++) {
                self->P[i * N + j] = self->P[j * N + i] = self->P[i * N + j] - K * PHt[j];
            }
            error[i] = K * innovation;
        }
        apply(self, error);
    }
    return score;
}

/* ErrorStateFilter.correct_scalar: S = h P h^T + variance */
real filter_correct_scalar(ErrorStateFilter *self, const real h[N], real innovation, real variance, real gate) {
    real PHt[N];
    memset(PHt, 0, sizeof PHt);
    for (int j = 0; j < N; j++) {
        bool counts = h[j] != REAL(0.0);
        for (int i = 0; counts && i < N; i++) {
            PHt[i] += self->P[i * N + j] * h[j];
        }
    }
    return correct_by(self, PHt, dot(PHt, h, N) + variance, innovation, gate);
}

/* ErrorStateFilter.correct_scalar with an index */
real filter_correct_component(ErrorStateFilter *self, int32_t index, real innovation, real variance, real gate) {
    real PHt[N];
    for (int i = 0; i < N; i++) {
        PHt[i] = self->P[i * N + index];
    }
    return correct_by(self, PHt, PHt[index] + variance, innovation, gate);
}

/* P <- P - L L', L [15, 3]; with -DDMRAC_WHOLE_COVARIANCE the products are of whole numbers. */
static void subtract_square(real P[N * N], const real L[N * 3]) {
#ifdef DMRAC_WHOLE_COVARIANCE
    int32_t whole[N * 3];
    real units[N];
    for (int i = 0; i < N; i++) {
        units[i] = block_of(L + 3 * i, 3, 1, whole + 3 * i);
    }
#endif
    for (int i = 0; i < N; i++) {
        for (int j = 0; j <= i; j++) {
#ifdef DMRAC_WHOLE_COVARIANCE
            real change = block_product(whole + 3 * i, units[i], whole + 3 * j, units[j]);
#else
            const real *a = L + 3 * i, *b = L + 3 * j;
            real change = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
#endif
            P[i * N + j] = P[j * N + i] = P[i * N + j] - change;
        }
    }
}

/* ErrorStateFilter._correct_three: three measurements at once, innovation y, by the Cholesky factor G of S. PHt [15, 3];
 * HPHt: the lower triangle, row by row. L = P H^T G^-T,  error = L G^-1 y,  P <- P - L L^T */
static real correct_three(ErrorStateFilter *self, const real PHt[N * 3], const real HPHt[6], const real y[3],
                          real variance, real gate) {
    /* G G^T = S = H P H^T + variance I. No pivot is less than the variance, except by rounding. */
    real g11 = real_sqrt(real_max(HPHt[0] + variance, variance));
    real g21 = HPHt[1] / g11, g31 = HPHt[3] / g11;
    real g22 = real_sqrt(real_max(HPHt[2] + variance - g21 * g21, variance));
    real g32 = (HPHt[4] - g31 * g21) / g22;
    real g33 = real_sqrt(real_max(HPHt[5] + variance - g31 * g31 - g32 * g32, variance));
    /* w = G^-1 y,  score = w . w = y^T S^-1 y */
    real w1 = y[0] / g11;
    real w2 = (y[1] - g21 * w1) / g22;
    real w3 = (y[2] - g31 * w1 - g32 * w2) / g33;
    real score = w1 * w1 + w2 * w2 + w3 * w3;
    if (!(score <= gate)) {
        return score;
    }
    real i21 = -g21 / (g11 * g22), i32 = -g32 / (g22 * g33);
    real i31 = -(g31 / g11 + g32 * i21) / g33;
    real L[N * 3], error[N];
    for (int i = 0; i < N; i++) {
        const real *row = PHt + 3 * i;
        L[3 * i] = row[0] * (REAL(1.0) / g11);
        L[3 * i + 1] = row[0] * i21 + row[1] * (REAL(1.0) / g22);
        L[3 * i + 2] = row[0] * i31 + row[1] * i32 + row[2] * (REAL(1.0) / g33);
        error[i] = L[3 * i] * w1 + L[3 * i + 1] * w2 + L[3 * i + 2] * w3;
    }
    subtract_square(self->P, L);
    apply(self, error);
    return score;
}

/* The lower triangle of three rows of PHt. */
static void lower_triangle(const real *rows, real HPHt[6]) {
    HPHt[0] = rows[0];
    HPHt[1] = rows[3];
    HPHt[2] = rows[4];
    HPHt[3] = rows[6];
    HPHt[4] = rows[7];
    HPHt[5] = rows[8];
}

/* ErrorStateFilter.correct_position: H P H^T = (P H^T)[p] - tau (P H^T)[v] */
real filter_correct_position(ErrorStateFilter *self, const real innovation[3], real delay_s, real variance, real gate) {
    real PHt[N * 3], rows[9], HPHt[6];
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < 3; j++) {
            PHt[3 * i + j] = self->P[i * N + POSITION + j] - delay_s * self->P[i * N + VELOCITY + j];
        }
    }
    for (int i = 0; i < 9; i++) {
        rows[i] = PHt[3 * POSITION + i] - delay_s * PHt[3 * VELOCITY + i];
    }
    lower_triangle(rows, HPHt);
    return correct_three(self, PHt, HPHt, innovation, variance, gate);
}

/* ErrorStateFilter.correct_attitude */
real filter_correct_attitude(ErrorStateFilter *self, const real innovation[3], real variance, real gate) {
    real PHt[N * 3], HPHt[6];
    for (int i = 0; i < N; i++) {
        vector_copy(self->P + i * N + ATTITUDE, PHt + 3 * i);
    }
    lower_triangle(PHt + 3 * ATTITUDE, HPHt);
    return correct_three(self, PHt, HPHt, innovation, variance, gate);
}

/* ErrorStateFilter.correct_past_attitude */
real filter_correct_past_attitude(ErrorStateFilter *self, const real innovation[3], real delay_s, real variance,
                                  real gate) {
    real PHt[N * 3], rows[9], HPHt[6], tau_R[9];
    for (int i = 0; i < 9; i++) {
        tau_R[i] = delay_s * self->rotation[i];
    }
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < 3; j++) {
            real turned = dot(self->P + i * N + GYRO_BIAS, tau_R + 3 * j, 3);
            PHt[3 * i + j] = self->P[i * N + ATTITUDE + j] + turned;
        }
    }
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            const real *bias = PHt + 3 * GYRO_BIAS + j, *R = tau_R + 3 * i;
            rows[3 * i + j] = PHt[3 * (ATTITUDE + i) + j] + (R[0] * bias[0] + R[1] * bias[3] + R[2] * bias[6]);
        }
    }
    lower_triangle(rows, HPHt);
    return correct_three(self, PHt, HPHt, innovation, variance, gate);
}

/* ErrorStateFilter.shift */
void filter_shift(ErrorStateFilter *self, const real dp[3], const real dv[3], const real phi[3]) {
    real turn[4];
    vector_add(self->position, dp, self->position);
    vector_add(self->velocity, dv, self->velocity);
    quaternion_of_rotation_vector(phi, turn);
    unit_product(turn, self->quaternion, self->quaternion);
    rotation_of(self->quaternion, self->rotation);
    history_correct(&self->history, dp, dv, phi);
}

/* ErrorStateFilter.forget_history */
void filter_forget_history(ErrorStateFilter *self) {
    history_clear(&self->history);
}

/* ErrorStateFilter.restart_error */
void filter_restart_error(ErrorStateFilter *self, int32_t start, real sigma) {
    for (int i = start; i < start + 3; i++) {
        for (int j = 0; j < N; j++) {
            self->P[i * N + j] = self->P[j * N + i] = REAL(0.0);
        }
    }
    for (int i = start; i < start + 3; i++) {
        self->P[i * N + i] = sigma * sigma;
    }
}

/* ErrorStateFilter.inflate */
void filter_inflate(ErrorStateFilter *self, int32_t start, real sigma, int32_t size) {
    for (int i = start; i < start + size; i++) {
        self->P[i * N + i] += sigma * sigma;
    }
}

/* ErrorStateFilter.inflate_motion */
void filter_inflate_motion(ErrorStateFilter *self, real sigma, real seconds) {
    real variance = sigma * sigma;
    for (int axis = 0; axis < 3; axis++) {
        int p = POSITION + axis, v = VELOCITY + axis;
        self->P[p * N + p] += variance * seconds * seconds;
        self->P[p * N + v] += variance * seconds;
        self->P[v * N + p] += variance * seconds;
        self->P[v * N + v] += variance;
    }
}
