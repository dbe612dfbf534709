/* Very many steps of the filter and of the law, for test_kalman.py: features that repeat, rest and turn over. */
#include <string.h>

#include "control/laws/kalman_last_layer.h"
#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

#define DT REAL(0.005)
#define REST_STEPS 20000 /* in every third stretch of so many, nothing changes */

int run_filter(KalmanLastLayer *layer, const real *turn, int steps, int every, real *S);
int run_law(KalmanLastLayer *layer, const real *turn, int steps, int every, real *S);

static void features(const real *turn, int n, int step, real *phi) {
    bool rests = step / REST_STEPS % 3 == 1;
    for (int i = 0; i < n; i++) {
        double angle = (double)turn[i] * (double)(step / 7) * 0.005 + (double)turn[i];
        phi[i] = rests || i >= n - 2 ? REAL(1.0) : real_tanh(REAL(2.0) * real_sin(angle_within_turn(angle)));
    }
}

/* Copy S every `every` steps; returns how many there are. */
static int keep(const KalmanState *state, int step, int every, real *S, int kept) {
    if (step % every != 0) {
        return kept;
    }
    size_t count = (size_t)(state->size * state->size);
    memcpy(S + (size_t)kept * count, state->S, count * sizeof(real));
    return kept + 1;
}

/* The correction with R alone, as small as the prior allows: the largest condition number. */
int run_filter(KalmanLastLayer *layer, const real *turn, int steps, int every, real *S) {
    real phi[STATES_MAX], g[STATES_MAX], x[3];
    KalmanState *state = &layer->state;
    int n = state->size, kept = 0;
    for (int step = 0; step < steps; step++) {
        features(turn, n, step, phi);
        kalman_state_predict(state, DT);
        kalman_state_along(state, phi, n, g, x);
        const real innovation[3] = {phi[0] - x[0], phi[1] - x[1], phi[2] - x[2]};
        kalman_state_correct(state, g, innovation, layer->noise_variance + dot(phi, g, n));
        kept = keep(state, step, every, S, kept);
    }
    return kept;
}

/* The law itself. */
int run_law(KalmanLastLayer *layer, const real *turn, int steps, int every, real *S) {
    real phi[STATES_MAX], Phi[3 * FEATURES_MAX], nu[3], nu_cmd[3];
    const real e[6] = {REAL(0.0)};
    int kept = 0, k = layer->feature_count;
    for (int step = 0; step < steps; step++) {
        features(turn, layer->state.size, step, phi);
        const real residual[3] = {phi[0], phi[1] * phi[2], REAL(3.0) * phi[3]};
        for (int i = 0; i < 3; i++) { /* the vehicle is on the path, and sees no other state ahead */
            memcpy(Phi + i * k, phi + 1, (size_t)k * sizeof(real));
        }
        kalman_layer_step(layer, Phi, e, residual, DT, nu, nu_cmd);
        kept = keep(&layer->state, step, every, S, kept);
    }
    return kept;
}
