#include "control/posterior_swap.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

enum { NETWORK, FEATURES, SLOPES, FILTER };

static int32_t quotient(int32_t count, int32_t size) {
    return (count + size - 1) / size;
}

/* The first of the recent states whose slope is checked. */
static int32_t first_checked(int32_t recent) {
    return recent > 0 ? (recent - 1) % SLOPE_STRIDE : 0;
}

/* How many of them are checked. */
static int32_t recent_checked(int32_t recent) {
    return quotient(recent - first_checked(recent), SLOPE_STRIDE);
}

/* The column of the i-th of the recent and followed states. */
static int32_t column_of(const PosteriorSwap *self, int32_t i) {
    return i < self->recent ? i : i + SWAP_NOW;
}

/* PosteriorSwap.__init__ */
void posterior_swap_begin(PosteriorSwap *self, const KalmanLastLayer *law, const ChannelFeatures *channel,
                          const RecentStates *recent, const real *now, real tick, real between) {
    features_take_network(&self->features, &channel->selection, &channel->network);
    memcpy(self->features.last_layer, channel->last_layer, sizeof self->features.last_layer);
    int32_t k = self->features.feature_count, n = recent_in_order(recent, self->states, self->residuals);
    memcpy(self->states + n * SIGNAL_COUNT, now, SWAP_NOW * SIGNAL_COUNT * sizeof(real));
    memset(self->residuals + 3 * n, 0, 3 * SWAP_NOW * sizeof(real));
    memcpy(self->theta, channel->last_layer, (size_t)(3 * k) * sizeof(real));
    kalman_start(&law->config, REAL(0.0), k, &self->filter);
    self->refusal = REFUSAL_NONE;
    self->recent = n;
    self->count = n + SWAP_NOW;
    self->seen = recent->pushes;
    self->stage = self->part = self->evaluated = self->used = 0;
    self->shares[0] = self->shares[1] = self->shares[2] = REAL(0.0);
    self->norms = REAL(1.0);
    memset(&self->map, 0, sizeof self->map);
    self->between = between;
    self->noise = kalman_layer_residual_variance(law, tick);
    self->parts[NETWORK] = 2 * channel->network.layers;
    self->parts[FEATURES] = quotient(n + SWAP_NOW, STATES_PER_PART);
    self->parts[SLOPES] = quotient(recent_checked(n) + SWAP_NOW, SLOPES_PER_PART);
    self->parts[FILTER] = n > 0 ? quotient(n, UPDATES_PER_PART) : 1;
}

/* PosteriorSwap._network */
static void step_network(PosteriorSwap *self, const SwapConfig *config, const KalmanLastLayer *law) {
    int32_t layer = self->part / 2, count = 3 * self->features.feature_count;
    if (self->part == 0 && norm(self->theta, count) > law->config.weight_norm_max) {
        self->refusal = REFUSAL_WEIGHT_NORM;
    } else if (self->part % 2 == 0) {
        features_take_layer(&self->features, layer);
    } else {
        self->norms *= features_layer_norm(&self->features, layer, &self->work);
        if (self->part + 1 == self->parts[NETWORK] && self->norms > config->lipschitz_max) {
            self->refusal = REFUSAL_LIPSCHITZ;
        }
    }
}

/* PosteriorSwap._evaluate */
static void evaluate_next(PosteriorSwap *self, int32_t most) {
    int32_t at = self->evaluated, left = self->count - at, n = left < most ? left : most;
    features_at(&self->features, self->states + at * SIGNAL_COUNT, n, self->Phi + at * FEATURES_MAX, FEATURES_MAX);
    self->evaluated += n;
}

/* PosteriorSwap._slopes */
static void step_slopes(PosteriorSwap *self, const SlopeLimits *limits) {
    const Features *features = &self->features;
    int32_t old = recent_checked(self->recent), first = self->part * SLOPES_PER_PART;
    for (int32_t i = first; i < first + SLOPES_PER_PART && i < old + SWAP_NOW; i++) {
        int32_t at = i < old ? first_checked(self->recent) + SLOPE_STRIDE * i : self->recent + i - old;
        real shares[3];
        largest_shares(features, features->last_layer, limits, self->states + at * SIGNAL_COUNT, 1, shares);
        for (int axis = 0; axis < 3; axis++) {
            self->shares[axis] = real_largest(self->shares[axis], shares[axis]);
        }
    }
    if (self->part + 1 == self->parts[SLOPES]) {
        flattened(self->shares, self->Phi, self->recent + SWAP_NOW, features->feature_count, self->theta);
    }
}

/* PosteriorSwap._filter_on. W does not revert within the second, b is an Ornstein-Uhlenbeck process from its stationary
 * variance on. */
static void filter_on(PosteriorSwap *self, const KalmanLastLayer *law, int32_t most) {
    int32_t k = self->features.feature_count;
    real phi[STATES_MAX], g[STATES_MAX], x[3], nu[3], innovation[3];
    bool learns = law->config.composite_gain > REAL(0.0); /* a law that is off flies the trained map */
    phi[k] = REAL(1.0);
    for (int32_t i = 0; i < most; i++) {
        int32_t at = column_of(self, self->used);
        if (at >= self->evaluated) {
            return;
        }
        const real *residual = self->residuals + 3 * at;
        memcpy(phi, self->Phi + at * FEATURES_MAX, (size_t)k * sizeof(real));
        weighted(self->theta, phi, k, nu);
        recent_map_add(&self->map, nu, residual);
        if (learns && self->used > 0) {
            kalman_state_predict(&self->filter, self->between);
        }
        if (learns) {
            kalman_state_along(&self->filter, phi, k + 1, g, x);
            for (int axis = 0; axis < 3; axis++) {
                innovation[axis] = residual[axis] - nu[axis] - x[axis];
            }
            kalman_state_correct(&self->filter, g, innovation, self->noise + dot(phi, g, k + 1));
        }
        self->used++;
    }
}

/* PosteriorSwap.step */
bool posterior_swap_step(PosteriorSwap *self, const SwapConfig *config, const KalmanLastLayer *law,
                         const SlopeLimits *limits) {
    switch (self->stage) {
        case NETWORK:
            step_network(self, config, law);
            break;
        case FEATURES:
            evaluate_next(self, STATES_PER_PART);
            break;
        case SLOPES:
            step_slopes(self, limits);
            break;
        default:
            filter_on(self, law, UPDATES_PER_PART);
    }
    if (++self->part == self->parts[self->stage]) {
        self->stage++;
        self->part = 0;
    }
    return self->refusal != REFUSAL_NONE || self->stage == SWAP_STAGES;
}

/* PosteriorSwap.follow */
void posterior_swap_follow(PosteriorSwap *self, const KalmanLastLayer *law, const RecentStates *recent) {
    if (recent->pushes > self->seen && self->count < self->recent + SWAP_NOW + FOLLOWED_MAX) {
        int32_t newest = (recent->next + recent->size - 1) % recent->size;
        self->seen = recent->pushes;
        memcpy(self->states + self->count * SIGNAL_COUNT, recent->ring + newest * SIGNAL_COUNT,
               SIGNAL_COUNT * sizeof(real));
        memcpy(self->residuals + self->count * 3, recent->residuals + newest * 3, 3 * sizeof(real));
        self->count++;
    }
    if (self->stage > FEATURES) {
        evaluate_next(self, 1);
    }
    if (self->stage > FILTER) {
        filter_on(self, law, 1);
    }
}

/* X and S as they are, about the new theta. */
static void keep_all(const KalmanLastLayer *law, const real *theta, KalmanState *out) {
    int count = 3 * law->feature_count;
    kalman_start(&law->config, law->config.prior_rate, law->feature_count, out);
    memcpy(out->S, law->state.S, (size_t)(out->size * out->size) * sizeof out->S[0]);
    for (int i = 0; i < count; i++) {
        out->X[i] = law->theta[i] + law->state.X[i] - theta[i];
    }
    memcpy(out->X + count, law->state.X + count, 3 * sizeof(real));
}

/* _judged, but for the refusal: the change of nu here, which b takes up unless the swap is naive, and that of nu_cmd ahead,
 * of a law that learns with the gap closed in the new features. Phi of the old and the new features [k, SWAP_NOW]. */
static void changes(const KalmanLastLayer *law, bool naive, const real *old, const real *new_ones, SwapPlan *plan) {
    real *b = plan->posterior.X + 3 * (plan->posterior.size - 1);
    bool learns = law->config.composite_gain > REAL(0.0);
    real before[3 * SWAP_NOW], after[3 * SWAP_NOW], here[3], ahead[3];
    kalman_layer_at(law, old, SWAP_NOW, before);
    kalman_evaluate(&law->config, plan->theta, &plan->posterior, new_ones, SWAP_NOW, after);
    kalman_layer_look_ahead(law, SWAP_NOW, after);
    for (int axis = 0; axis < 3; axis++) {
        real *row = after + SWAP_NOW * axis;
        if (learns) {
            row[1] += row[0] - row[2];
        }
        here[axis] = row[0] - before[SWAP_NOW * axis];
        ahead[axis] = row[1] - before[SWAP_NOW * axis + 1];
        if (learns && !naive) {
            b[axis] -= here[axis];
            ahead[axis] -= here[axis];
            here[axis] -= here[axis]; /* NaN stays */
        }
    }
    plan->step = norm(ahead, 3);
    plan->jump = real_largest(norm(here, 3), plan->step);
}

/* PosteriorSwap.plan */
void posterior_swap_plan(PosteriorSwap *self, const SwapConfig *config, const KalmanLastLayer *law, const Features *old,
                         const real *now, real since, SwapPlan *plan) {
    int32_t k = self->features.feature_count;
    KalmanState *state = &plan->posterior;
    real Phi[FEATURES_MAX * SWAP_NOW], Phi_bar[FEATURES_MAX * SWAP_NOW];
    memcpy(plan->theta, self->theta, (size_t)(3 * k) * sizeof(real));
    memcpy(plan->W, self->theta, (size_t)(3 * k) * sizeof(real));
    plan->jump = plan->step = REAL(0.0);
    plan->refusal = self->refusal;
    if (plan->refusal != REFUSAL_NONE) {
        return;
    }
    evaluate_next(self, FOLLOWED_MAX);
    filter_on(self, law, FOLLOWED_MAX);
    if (self->used > 0 && law->config.composite_gain > REAL(0.0)) {
        kalman_state_predict(&self->filter, since);
    }
    kalman_state_copy(state, &self->filter);
    if (config->naive && law->feature_count == k) {
        keep_all(law, plan->theta, state);
    }
    features_of_states(old, now, SWAP_NOW, Phi);
    features_of_states(&self->features, now, SWAP_NOW, Phi_bar);
    changes(law, config->naive, Phi, Phi_bar, plan);
    for (int i = 0; i < 3 * k; i++) {
        plan->W[i] = plan->theta[i] + state->X[i];
    }
    if (!real_is_finite(plan->jump) || !kalman_state_is_finite(state)) {
        plan->refusal = REFUSAL_NOT_FINITE;
    } else if (norm(state->X, 3 * state->size) > law->config.weight_norm_max) {
        plan->refusal = REFUSAL_WEIGHT_NORM;
    } else if (plan->step > config->jump_max) {
        plan->refusal = REFUSAL_SWAP_JUMP;
    }
}
