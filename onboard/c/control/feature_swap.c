#include "control/feature_swap.h"

#include <math.h>
#include <string.h>

#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

/* RecentStates.__init__ */
void recent_init(RecentStates *self, int32_t size) {
    self->size = size;
    self->filled = self->next = 0;
    self->pushes = 0;
}

/* RecentStates.push */
void recent_push(RecentStates *self, const real signals[SIGNAL_COUNT], const real residual[3]) {
    memcpy(self->ring + self->next * SIGNAL_COUNT, signals, SIGNAL_COUNT * sizeof(real));
    memcpy(self->residuals + self->next * 3, residual, 3 * sizeof(real));
    self->next = (self->next + 1) % self->size;
    self->filled = self->filled < self->size ? self->filled + 1 : self->size;
    self->pushes++;
}

/* RecentStates.columns */
int32_t recent_states(const RecentStates *self, const real now[SIGNAL_COUNT], const real ahead[SIGNAL_COUNT],
                      real *states) {
    if (self->filled == 0) {
        return 0;
    }
    size_t vector_size = SIGNAL_COUNT * sizeof(real);
    memcpy(states, self->ring, (size_t)self->filled * vector_size);
    memcpy(states + self->filled * SIGNAL_COUNT, now, vector_size);
    memcpy(states + (self->filled + 1) * SIGNAL_COUNT, ahead, vector_size);
    return self->filled + 2;
}

/* RecentStates.in_order */
int32_t recent_in_order(const RecentStates *self, real *states, real *residuals) {
    int32_t oldest = self->filled == self->size ? self->next : 0;
    for (int i = 0; i < self->filled; i++) {
        int32_t at = (oldest + i) % self->size;
        memcpy(states + i * SIGNAL_COUNT, self->ring + at * SIGNAL_COUNT, SIGNAL_COUNT * sizeof(real));
        memcpy(residuals + i * 3, self->residuals + at * 3, 3 * sizeof(real));
    }
    return self->filled;
}

/* out [3, n] = W' Phi */
static void outputs(const real *W, const real *Phi, int32_t k, int32_t n, real *out) {
    for (int i = 0; i < n; i++) {
        for (int axis = 0; axis < 3; axis++) {
            real sum = REAL(0.0);
            for (int j = 0; j < k; j++) {
                sum += W[3 * j + axis] * Phi[j * n + i];
            }
            out[axis * n + i] = sum;
        }
    }
}

/* resemblance */
real resemblance(const real *Phi, const real *Phi_bar, int32_t k, int32_t n) {
    int count = (k - 1) * n;
    real size = norm(Phi, count), change = REAL(0.0);
    for (int i = 0; i < count; i++) {
        real difference = Phi_bar[i] - Phi[i];
        change += difference * difference;
    }
    change = real_sqrt(change);
    return change < size ? REAL(1.0) - change / size : REAL(0.0);
}

/* bumpless_last_layer: W = W_bar + (Phi_bar Phi_bar' + mu I)^-1 Phi_bar (nu - W_bar' Phi_bar)'. Without a solution, which
 * only numbers that are not finite cause, W is not finite either. */
static void bumpless_last_layer(SwapWorkspace *work, int32_t k, int32_t n, real mu, real *W) {
    real *S = work->square;
    gram(work->Phi_bar, k, n, n, S);
    for (int i = 0; i < k; i++) {
        S[i * k + i] += mu;
    }
    for (int j = 0; j < k; j++) {
        W[3 * j] = W[3 * j + 1] = W[3 * j + 2] = REAL(0.0);
    }
    for (int i = 0; i < n; i++) {
        for (int axis = 0; axis < 3; axis++) {
            real mismatch = work->nu[axis * n + i];
            for (int j = 0; j < k; j++) {
                mismatch -= work->W_bar[3 * j + axis] * work->Phi_bar[j * n + i];
            }
            for (int j = 0; j < k; j++) {
                W[3 * j + axis] += work->Phi_bar[j * n + i] * mismatch;
            }
        }
    }
    bool solved = cholesky_solve(S, W, k, 3);
    for (int j = 0; j < 3 * k; j++) {
        W[j] = solved ? work->W_bar[j] + W[j] : REAL(NAN);
    }
}

real column_norm(const real *change, int32_t n, int32_t column) {
    const real one[3] = {change[column], change[n + column], change[2 * n + column]};
    return norm(one, 3);
}

real largest_column(const real *change, int32_t n) {
    real largest = REAL(0.0);
    for (int i = 0; i < n; i++) {
        largest = real_largest(largest, column_norm(change, n, i));
    }
    return largest;
}

/* W_bar = theta_n + s (W - theta_n); theta_n alone where the shapes differ */
static void weighted_memory(SwapWorkspace *work, const real *W, const real *memory, bool same_shape, int32_t k,
                            int32_t n) {
    real s = same_shape ? resemblance(work->Phi, work->Phi_bar, k, n) : REAL(0.0);
    for (int i = 0; i < 3 * k; i++) {
        work->W_bar[i] = same_shape ? memory[i] + s * (W[i] - memory[i]) : memory[i];
    }
}

/* plan_swap */
void plan_swap(const SwapConfig *config, const Features *old, const real *W, const Features *new_features,
               const real *memory, real weight_norm_max, int32_t n, SwapWorkspace *work, SwapPlan *plan) {
    int k_old = old->feature_count, k = new_features->feature_count;
    bool same_shape = k_old == k;
    memcpy(plan->W, memory, (size_t)(3 * k) * sizeof(real));
    memcpy(plan->theta, memory, (size_t)(3 * k) * sizeof(real));
    plan->jump = plan->step = REAL(0.0);
    plan->refusal = REFUSAL_NONE;
    if (network_lipschitz(&new_features->network, new_features->selection.count, work->square) >
        config->lipschitz_max) {
        plan->refusal = REFUSAL_LIPSCHITZ;
    } else if (norm(memory, 3 * k) > weight_norm_max) {
        plan->refusal = REFUSAL_WEIGHT_NORM;
    }
    if (plan->refusal != REFUSAL_NONE || n == 0) {
        return;
    }
    features_of_states(old, work->states, n, work->Phi);
    outputs(W, work->Phi, k_old, n, work->nu);
    features_of_states(new_features, work->states, n, work->Phi_bar);
    if (!config->naive) {
        weighted_memory(work, W, memory, same_shape, k, n);
        bumpless_last_layer(work, k, n, config->memory_weight * (real)n, plan->W);
    } else if (same_shape) {
        memcpy(plan->W, W, (size_t)(3 * k) * sizeof(real));
    }
    outputs(plan->W, work->Phi_bar, k, n, work->change);
    for (int i = 0; i < 3 * n; i++) {
        work->change[i] -= work->nu[i];
    }
    plan->jump = largest_column(work->change, n);
    if (!real_is_finite(plan->jump)) {
        plan->refusal = REFUSAL_NOT_FINITE;
        return;
    }
    if (norm(plan->W, 3 * k) > weight_norm_max * real_sqrt(REAL(1.0) + PROJECTION_MARGIN)) {
        plan->refusal = REFUSAL_WEIGHT_NORM;
        return;
    }
    plan->step = column_norm(work->change, n, n - 1);
    if (plan->jump > config->jump_max) {
        plan->refusal = REFUSAL_SWAP_JUMP;
    }
}
