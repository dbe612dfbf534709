#include "control/tracking_bound.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

static real integral_of(const Majorant *one) {
    return one->gain / (one->fast * one->slow);
}

/* majorant */
void majorant(real omega, real zeta, Majorant *out) {
    if (zeta >= REAL(1.0)) {
        real root = real_sqrt(zeta * zeta - REAL(1.0));
        *out = (Majorant){omega * (zeta + root), omega * (zeta - root), REAL(1.0)};
        return;
    }
    real decay = zeta * omega, ripple = omega * real_sqrt(REAL(1.0) - zeta * zeta);
    Majorant spread = {decay + SPREAD * ripple, decay, OVERSHOOT};
    Majorant equal = {decay, decay, REAL(1.0)};
    *out = integral_of(&equal) < integral_of(&spread) ? equal : spread;
}

/* AxisBound.__init__ */
static void axis_init(AxisBound *self, real omega, real zeta) {
    memset(self, 0, sizeof *self);
    self->k1 = omega * omega;
    self->k2 = REAL(2.0) * zeta * omega;
    majorant(omega, zeta, &self->majorant);
}

/* AxisBound.prepare: the steps are exact for |w| constant over the period */
static void axis_prepare(AxisBound *self, real dt) {
    real p1 = self->majorant.fast, p2 = self->majorant.slow, gain = self->majorant.gain;
    real a1 = real_exp(-p1 * dt), a2 = real_exp(-p2 * dt);
    self->keep1 = a1;
    self->feed1 = gain * (REAL(1.0) - a1) / p1;
    self->keep2 = a2;
    self->pass2 = p1 - p2 < REAL(1e-6) * p1 ? dt * a2 : (a2 - a1) / (p1 - p2);
    self->feed2 = gain * ((REAL(1.0) - a2) / p2 - self->pass2) / p1;
    self->share = REAL(1.0) - real_exp(-dt / BOUND_RESIDUAL_FILTER_S);
}

/* AxisBound.forget */
static void axis_forget(AxisBound *self) {
    self->once = self->twice = REAL(0.0);
}

/* AxisBound.restart */
static real axis_restart(AxisBound *self, real a_d, real d, real d_rate) {
    self->pull = a_d + self->k1 * d + self->k2 * d_rate;
    self->z1 = self->majorant.gain * real_abs(d_rate + self->majorant.slow * d);
    self->z2 = real_abs(d);
    self->response = self->response_rate = REAL(0.0);
    return self->z2;
}

/* AxisBound.step: w = a_d - u_hat - Delta_hat + k1 d + k2 d_rate */
static real axis_step(AxisBound *self, real a_d, real u_hat, real residual, real d, real d_rate) {
    self->once = self->once + self->share * (residual - self->once);
    self->twice = self->twice + self->share * (self->once - self->twice);
    real before = self->pull;
    self->pull = a_d + self->k1 * d + self->k2 * d_rate;
    real size = real_abs(REAL(0.5) * (before + self->pull) - u_hat - REAL(2.0) * self->once + self->twice);
    self->z2 = self->keep2 * self->z2 + self->pass2 * self->z1 + self->feed2 * size;
    self->z1 = self->keep1 * self->z1 + self->feed1 * size;
    return self->z2;
}

/* AxisBound.respond */
static real axis_respond(AxisBound *self, real turn, real omega_d, real alpha_d, real dt) {
    real s = self->response, rate = self->response_rate;
    real alpha = self->k1 * s - self->k2 * (rate - omega_d) + alpha_d;
    self->response = s - dt * (rate + REAL(0.5) * dt * alpha) + turn;
    self->response_rate = rate + dt * alpha;
    return self->response;
}

/* TrackingBounds.__init__ */
void tracking_bounds_init(TrackingBounds *self, const ChannelGains *position, const ChannelGains *attitude) {
    memset(self, 0, sizeof *self);
    for (int i = 0; i < 3; i++) {
        axis_init(self->position + i, position->natural_frequency_rad_s[i], position->damping[i]);
        axis_init(self->attitude + i, attitude->natural_frequency_rad_s[i], attitude->damping[i]);
    }
}

/* TrackingBounds.reset */
void tracking_bounds_reset(TrackingBounds *self) {
    self->running = false;
}

/* TrackingBounds._start */
static void start(TrackingBounds *self, real period) {
    self->running = true;
    self->period = period;
    for (int i = 0; i < 3; i++) {
        axis_forget(self->position + i);
        axis_prepare(self->position + i, period);
        axis_forget(self->attitude + i);
        axis_prepare(self->attitude + i, period);
    }
}

/* TrackingBounds._position_bound: on the true distance to the path: that of the estimate, and what that may be off */
static real position_bound(TrackingBounds *self, const ControlInputs *inputs, bool restart) {
    const PathPoint *path = &inputs->target->path;
    const VehicleState *state = inputs->state;
    real squared = REAL(0.0);
    for (int i = 0; i < 3; i++) {
        AxisBound *axis = self->position + i;
        real v = state->velocity[i], u = inputs->position->u_hat[i], a_d = path->acceleration[i];
        real d = path->position[i] - state->position[i], d_rate = path->velocity[i] - v;
        real residual = (v - self->velocity[i]) / inputs->dt - u;
        real bound = restart ? axis_restart(axis, a_d, d, d_rate) : axis_step(axis, a_d, u, residual, d, d_rate);
        self->velocity[i] = v;
        squared += bound * bound;
    }
    return real_sqrt(squared) + ESTIMATE_SIGMAS * state->position_sigma_m;
}

/* TrackingBounds._attitude_bound: on the angle between the vehicle and the commanded attitude; axes: body FRD */
static real attitude_bound(TrackingBounds *self, const ControlInputs *inputs, const real commanded[4],
                           const CommandMotion *motion, bool restart) {
    const ChannelMeasurement *measured = inputs->attitude;
    const real *omega_d = motion->omega_d, *alpha_d = motion->alpha_d;
    real e[3], squared = REAL(0.0);
    turn_between(inputs->state->quaternion, commanded, e);
    for (int i = 0; i < 3; i++) {
        AxisBound *axis = self->attitude + i;
        real rate = inputs->state->rates[i], bound;
        if (restart) {
            bound = axis_restart(axis, REAL(0.0), e[i], -rate);
        } else {
            bound = real_abs(axis_respond(axis, motion->turn[i], omega_d[i], alpha_d[i], inputs->dt));
            bound += axis_step(axis, alpha_d[i], measured->u_hat[i], measured->residual[i], e[i], omega_d[i] - rate);
        }
        squared += bound * bound;
    }
    return real_sqrt(squared);
}

/* TrackingBounds.step */
void tracking_bounds_step(TrackingBounds *self, const ControlInputs *inputs, const real commanded[4],
                          const CommandMotion *motion, real bounds[2]) {
    bounds[0] = bounds[1] = REAL(0.0);
    if (!inputs->adapt) {
        self->running = false;
        return;
    }
    real period = inputs->dt / (real)(1 + inputs->missed); /* ControlInputs.period */
    bool restart = !self->running || inputs->missed > 0 || inputs->state->position_reset_count != self->resets_seen;
    if (!self->running || period != self->period) {
        start(self, period);
    }
    self->resets_seen = inputs->state->position_reset_count;
    bounds[0] = position_bound(self, inputs, restart);
    bounds[1] = attitude_bound(self, inputs, commanded, motion, restart);
}
