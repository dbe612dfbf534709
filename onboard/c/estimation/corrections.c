#include "estimation/corrections.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/whole.h"
#include "protocol/geometry.h"

/* Corrections.__init__ */
void corrections_init(Corrections *self, const EstimatorConfig *config) {
    memset(self, 0, sizeof *self);
    self->jump_threshold_m = config->jump_threshold_m;
    self->recovery_ns = nanoseconds_below(config->recovery_s);
}

/* Corrections.note_score */
void corrections_note_score(Corrections *self, Aid aid, real score, real gate, int32_t dimension) {
    self->scores[aid] = score;
    if (self->in_flight && score <= gate) {
        self->score_sums[aid] += score / (real)dimension;
        self->score_counts[aid]++;
    }
}

/* Corrections.correct, after the correction itself */
bool corrections_conclude(Corrections *self, const ErrorStateFilter *filter, VehicleState *state, Aid aid, real score,
                          real gate, const real before[3], int64_t now_ns) {
    corrections_note_score(self, aid, score, gate, 1);
    if (score > gate) {
        self->refused[aid]++;
        if (self->refused_in_a_row[aid]++ == 0) {
            self->refused_since_ns[aid] = now_ns;
        }
        return false;
    }
    self->used[aid]++;
    self->refused_in_a_row[aid] = 0;
    corrections_announce_jump(self, filter, state, before, aid, now_ns, REAL(0.0), false);
    return true;
}

/* Corrections.refused_long */
bool corrections_refused_long(const Corrections *self, Aid aid, int64_t now_ns) {
    int32_t count = self->refused_in_a_row[aid];
    return count >= REFUSED_MIN && now_ns - self->refused_since_ns[aid] > self->recovery_ns;
}

/* Corrections.widen */
void corrections_widen(Corrections *self, ErrorStateFilter *filter, Aid aid, int32_t start, int32_t size, real sigma,
                       int64_t now_ns) {
    filter_inflate(filter, start, sigma, size);
    self->refused_in_a_row[aid] = 0;
    self->recovered[aid]++;
    estimator_report(&self->events, now_ns, ESTIMATOR_WIDENED, (int32_t)aid);
}

/* math.remainder(angle, 2 pi), for angles within a few turns */
static real within_half_turn(real angle) {
    while (angle > REAL_PI) {
        angle -= REAL(2.0) * REAL_PI;
    }
    while (angle < -REAL_PI) {
        angle += REAL(2.0) * REAL_PI;
    }
    return angle;
}

/* Corrections.announce_jump */
void corrections_announce_jump(Corrections *self, const ErrorStateFilter *filter, VehicleState *state,
                               const real before[3], Aid cause, int64_t now_ns, real yaw, bool always) {
    real jump[3];
    vector_subtract(filter->position, before, jump);
    real length_m = vector_length(jump);
    if (!always && length_m < self->jump_threshold_m) {
        return;
    }
    state->position_reset_count++;
    vector_copy(jump, state->position_jump);
    state->yaw_jump = within_half_turn(yaw);
    vector_copy(filter->position, state->position);
    estimator_report(&self->events, now_ns, ESTIMATOR_JUMPED, (int32_t)cause)->values[0] = length_m;
}
