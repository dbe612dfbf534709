#include "estimation/state_history.h"

#include <string.h>

/* StateHistory.__init__ */
void history_init(StateHistory *self) {
    memset(self, 0, sizeof *self);
    self->newest = -1;
}

/* StateHistory.append */
void history_append(StateHistory *self, const PastState *state) {
    self->time_s = (double)state->time_ns * 1e-9;
    self->newest = (self->newest + 1) % HISTORY_LENGTH;
    StoredState *stored = self->states + self->newest;
    stored->used = true;
    stored->state = *state;
    stored->sums = self->sums;
}

/* StateHistory.correct */
void history_correct(StateHistory *self, const real dp[3], const real dv[3], const real phi[3]) {
    for (int i = 0; i < 3; i++) {
        self->sums.dp[i] += (double)dp[i];
        self->sums.dv[i] += (double)dv[i];
        self->sums.dvt[i] += (double)dv[i] * self->time_s;
        self->sums.phi[i] += (double)phi[i];
    }
}

/* R = R_past + [turn]x R_past */
static void turn_rotation(const real past[9], const real turn[3], real out[9]) {
    for (int c = 0; c < 3; c++) {
        real x = past[c], y = past[3 + c], z = past[6 + c];
        out[c] = x - turn[2] * y + turn[1] * z;
        out[3 + c] = y + turn[2] * x - turn[0] * z;
        out[6 + c] = z - turn[1] * x + turn[0] * y;
    }
}

/* StateHistory._corrected. du = dv_sum - dv_sum_past, v = v_past + du
 * p = p_past + dp_sum - dp_sum_past - ((dv t)_sum - (dv t)_sum_past - t_past du) + v (t_c - t_past)
 * turn = phi_sum - phi_sum_past + omega (t_c - t_past): a few corrections and at most one sample, so small */
static void corrected(const StateHistory *self, const StoredState *past, int64_t time_ns, PastState *out) {
    double t = (double)past->state.time_ns * 1e-9;
    real ahead = (real)(time_ns - past->state.time_ns) * REAL(1e-9), turn[3];
    for (int i = 0; i < 3; i++) {
        double du = self->sums.dv[i] - past->sums.dv[i];
        real v = past->state.velocity[i] + (real)du;
        double moved = self->sums.dp[i] - past->sums.dp[i] - (self->sums.dvt[i] - past->sums.dvt[i] - t * du);
        out->velocity[i] = v;
        out->position[i] = past->state.position[i] + (real)moved + v * ahead;
        turn[i] = (real)(self->sums.phi[i] - past->sums.phi[i]) + past->state.rate_world[i] * ahead;
        out->rate_world[i] = past->state.rate_world[i];
    }
    turn_rotation(past->state.rotation, turn, out->rotation);
    out->time_ns = time_ns;
}

/* StateHistory.at */
bool history_at(const StateHistory *self, int64_t time_ns, PastState *out) {
    int32_t index = self->newest < 0 ? HISTORY_LENGTH - 1 : self->newest;
    for (int32_t i = 0; i < HISTORY_LENGTH; i++) {
        const StoredState *past = self->states + index;
        if (!past->used) {
            return false;
        }
        if (past->state.time_ns <= time_ns) {
            corrected(self, past, time_ns, out);
            return true;
        }
        index = (index + HISTORY_LENGTH - 1) % HISTORY_LENGTH;
    }
    return false;
}

/* StateHistory.clear */
void history_clear(StateHistory *self) {
    for (int32_t i = 0; i < HISTORY_LENGTH; i++) {
        self->states[i].used = false;
    }
}
