#include "control/posterior_swap.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

/* posterior. W does not revert within the second, b is an Ornstein-Uhlenbeck process from its stationary variance on. */
void posterior(const KalmanLastLayer *law, const real *theta, const real *Phi, int32_t columns, int32_t k,
               const real *y, int32_t n, const SwapTimes *times, KalmanState *out) {
    real noise = kalman_layer_residual_variance(law, times->tick);
    real phi[STATES_MAX], g[STATES_MAX], x[3], innovation[3];
    kalman_start(&law->config, REAL(0.0), k, out);
    phi[k] = REAL(1.0);
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < k; j++) {
            phi[j] = Phi[j * columns + i];
        }
        if (i > 0) {
            kalman_state_predict(out, times->between);
        }
        kalman_state_along(out, phi, k + 1, g, x);
        for (int axis = 0; axis < 3; axis++) {
            real of_theta = REAL(0.0);
            for (int j = 0; j < k; j++) {
                of_theta += theta[3 * j + axis] * phi[j];
            }
            innovation[axis] = y[3 * i + axis] - of_theta - x[axis];
        }
        kalman_state_correct(out, g, innovation, noise + dot(phi, g, k + 1));
    }
    if (n > 0) {
        kalman_state_predict(out, times->since);
    }
}

/* X and S as they are, about the new theta. */
static void keep_all(const KalmanLastLayer *law, const real *theta, KalmanState *out) {
    int count = 3 * law->feature_count;
    kalman_start(&law->config, law->config.prior_rate, law->feature_count, out);
    memcpy(out->S, law->state.S, (size_t)(out->size * out->size) * sizeof(real));
    for (int i = 0; i < count; i++) {
        out->X[i] = law->theta[i] + law->state.X[i] - theta[i];
    }
    memcpy(out->X + count, law->state.X + count, 3 * sizeof(real));
}

static void first_plan(const SwapConfig *config, const KalmanLastLayer *law, const Features *new_features,
                       SwapWorkspace *work, SwapPlan *plan) {
    int count = 3 * new_features->feature_count;
    memcpy(plan->W, new_features->last_layer, (size_t)count * sizeof(real));
    memcpy(plan->theta, new_features->last_layer, (size_t)count * sizeof(real));
    plan->jump = plan->step = REAL(0.0);
    plan->refusal = REFUSAL_NONE;
    if (network_lipschitz(&new_features->network, new_features->selection.count, work->square) >
        config->lipschitz_max) {
        plan->refusal = REFUSAL_LIPSCHITZ;
    } else if (norm(new_features->last_layer, count) > law->config.weight_norm_max) {
        plan->refusal = REFUSAL_WEIGHT_NORM;
    }
}

/* The change of nu at the n states. Of a law that learns, the gap is closed in the new features; unless the swap is naive, b
 * takes up the change at the present state. The last three states are the present one, the path ahead, where nu is nu_cmd, and
 * the path now, whose change does not count. */
static void changes(const KalmanLastLayer *law, bool naive, int32_t n, SwapWorkspace *work, SwapPlan *plan) {
    const int32_t here = n - 3, ahead = n - 2, path = n - 1;
    real *b = plan->posterior.X + 3 * (plan->posterior.size - 1);
    bool learns = law->config.composite_gain > REAL(0.0);
    kalman_layer_at(law, work->Phi, n, work->nu);
    kalman_evaluate(&law->config, plan->theta, &plan->posterior, work->Phi_bar, n, work->change);
    for (int axis = 0; axis < 3; axis++) {
        real *row = work->change + axis * n;
        if (learns) {
            row[ahead] += row[here] - row[path];
        }
        for (int i = 0; i < n; i++) {
            row[i] -= work->nu[axis * n + i];
        }
        real taken_up = learns && !naive ? row[here] : REAL(0.0);
        b[axis] -= taken_up;
        for (int i = 0; i < n; i++) {
            row[i] -= taken_up;
        }
        row[path] = REAL(0.0);
    }
    plan->jump = largest_column(work->change, n);
    plan->step = column_norm(work->change, n, ahead);
}

static bool all_finite(const real *values, int count) {
    for (int i = 0; i < count; i++) {
        if (!real_is_finite(values[i])) {
            return false;
        }
    }
    return true;
}

/* plan_posterior_swap */
void plan_posterior_swap(const SwapConfig *config, const KalmanLastLayer *law, const Features *old,
                         const Features *new_features, const SlopeLimits *limits, const RecentStates *recent,
                         const real *now, const SwapTimes *times, SwapWorkspace *work, SwapPlan *plan) {
    int k = new_features->feature_count;
    KalmanState *state = &plan->posterior;
    first_plan(config, law, new_features, work, plan);
    if (plan->refusal != REFUSAL_NONE) {
        return;
    }
    int kept = recent_in_order(recent, work->states, work->residuals), n = kept + 3;
    memcpy(work->states + kept * SIGNAL_COUNT, now, 3 * SIGNAL_COUNT * sizeof(real));
    features_of_states(old, work->states, n, work->Phi);
    features_of_states(new_features, work->states, n, work->Phi_bar);
    bounded_theta(new_features, new_features->last_layer, limits, work->states, work->Phi_bar, n, plan->theta);
    bool off = law->config.composite_gain == REAL(0.0); /* a law that is off flies the trained map */
    if (config->naive && law->feature_count == k) {
        keep_all(law, plan->theta, state);
    } else {
        posterior(law, plan->theta, work->Phi_bar, n, k, work->residuals, off ? 0 : kept, times, state);
    }
    changes(law, config->naive, n, work, plan);
    for (int i = 0; i < 3 * k; i++) {
        plan->W[i] = plan->theta[i] + state->X[i];
    }
    if (!real_is_finite(plan->jump) || !all_finite(state->S, state->size * state->size)) {
        plan->refusal = REFUSAL_NOT_FINITE;
    } else if (norm(state->X, 3 * state->size) > law->config.weight_norm_max) {
        plan->refusal = REFUSAL_WEIGHT_NORM;
    } else if (plan->step > config->jump_max) {
        plan->refusal = REFUSAL_SWAP_JUMP;
    }
}
