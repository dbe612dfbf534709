#include "flight/guidance.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

static const real NO_OFFSET[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};

/* Guidance.__init__ */
void guidance_init(Guidance *self, const GuidanceConfig *config, const Swing *lissajous) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    path_init(&self->path, &config->trajectory, lissajous);
    path_clock_init(&self->clock);
}

/* Guidance.finished */
bool guidance_finished(const Guidance *self) {
    return self->clock.time_s >= (double)self->config.land_after_s;
}

/* Guidance.start */
void guidance_start(Guidance *self, const VehicleState *state) {
    vector_copy(state->position, self->origin);
    path_clock_init(&self->clock);
    self->descent_m = self->descent_speed = REAL(0.0);
    vector_zero(self->offset);
}

/* any(offset) */
static bool is_off(const real offset[3]) {
    return offset[0] != REAL(0.0) || offset[1] != REAL(0.0) || offset[2] != REAL(0.0);
}

/* Guidance.follow_jump */
void guidance_follow_jump(Guidance *self, const VehicleState *state, bool posed) {
    if (state->position_reset_count == self->resets_seen) {
        return;
    }
    self->resets_seen = state->position_reset_count;
    if (posed && !self->posed) {
        vector_add(self->origin, state->position_jump, self->origin); /* shift */
    } else {
        vector_add(self->offset, state->position_jump, self->offset);
        self->return_speed = REAL(0.0);
    }
    self->posed = posed;
}

/* Guidance._at: the path's point `lead_s` from now, and beside it the offset, which decreases at the relative rate */
static void point_at(const Guidance *self, real lead_s, const real offset[3], real rate, PathPoint *out) {
    const PathClock *clock = &self->clock;
    path_at(&self->path, clock->time_s + (double)(clock->rate * lead_s), out);
    if (!path_clock_steady(clock)) {
        path_clock_ahead(clock, out);
    }
    vector_add(self->origin, out->position, out->position);
    out->position[2] = out->position[2] + self->descent_m + self->descent_speed * lead_s;
    out->velocity[2] += self->descent_speed;
    if (is_off(offset)) {
        real share = real_max(REAL(0.0), REAL(1.0) - rate * lead_s);
        for (int i = 0; i < 3; i++) {
            out->position[i] += share * offset[i];
            out->velocity[i] -= share != REAL(0.0) ? rate * offset[i] : REAL(0.0);
        }
    }
}

/* Guidance.place */
void guidance_place(Guidance *self, const real position[3]) {
    PathPoint now;
    vector_zero(self->offset);
    point_at(self, REAL(0.0), NO_OFFSET, REAL(0.0), &now);
    for (int i = 0; i < 3; i++) {
        self->origin[i] += position[i] - now.position[i];
    }
}

/* Guidance.rest */
void guidance_rest(Guidance *self, const real position[3]) {
    self->descent_speed = REAL(0.0);
    guidance_place(self, position);
}

/* Guidance._return: d offset / dt = -rate offset */
static real return_rate(Guidance *self, real dt) {
    real far = vector_length(self->offset);
    if (far == REAL(0.0)) {
        return REAL(0.0);
    }
    real speed = real_min(real_min(self->return_speed + RETURN_M_S2 * dt, self->config.return_speed_m_s),
                          real_sqrt(REAL(2.0) * RETURN_M_S2 * far));
    real left = real_max(REAL(0.0), REAL(1.0) - speed * dt / far);
    bool arrived = left == REAL(0.0);
    self->return_speed = arrived ? REAL(0.0) : speed;
    vector_scale(self->offset, left, self->offset);
    return arrived ? REAL(0.0) : speed / (far * left);
}

/* Guidance.step */
void guidance_step(Guidance *self, bool run, bool landing, double seconds, bool climbing, Target *out) {
    real dt = (real)seconds;
    const GuidanceConfig *config = &self->config;
    bool waits = climbing && self->clock.time_s >= self->path.start_s - (double)self->clock.stop_s;
    path_clock_step(&self->clock, run && !landing && !waits, seconds);
    real speed = config->trajectory.landing_speed_m_s; /* reached within a second, and left as fast */
    real change = landing ? dt * speed : -dt * speed;
    self->descent_speed = real_min(real_max(self->descent_speed + change, REAL(0.0)), speed);
    self->descent_m += dt * self->descent_speed;
    real rate = return_rate(self, dt);
    PathPoint lead[3];
    point_at(self, REAL(0.0), NO_OFFSET, REAL(0.0), &out->path);
    if (is_off(self->offset)) {
        point_at(self, REAL(0.0), self->offset, rate, &out->now);
    } else {
        out->now = out->path;
    }
    point_at(self, config->look_ahead_s, self->offset, rate, &out->ahead);
    point_at(self, config->attitude_look_ahead_s, self->offset, rate, &out->attitude_ahead);
    for (int i = 0; i < 3; i++) {
        real lead_s = config->feed_forward_lead_s + (real)(i - 1) * TURN_STEP_S;
        point_at(self, lead_s, NO_OFFSET, REAL(0.0), lead + i);
    }
    vector_copy(lead[1].acceleration, out->feed_forward);
    path_turn(lead[0].acceleration, lead[1].acceleration, lead[2].acceleration, &out->turn);
    out->yaw_rad = config->trajectory.yaw_rad;
    /* On a hold or landing the target no longer moves as in the laps before. */
    bool steady = path_clock_steady(&self->clock);
    out->lap_phase = steady ? path_lap_phase(&self->path, self->clock.time_s) : -1.0;
    out->lap_s = path_lap_s(&self->path);
}
