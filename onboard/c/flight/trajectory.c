#include "flight/trajectory.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* The phase of a periodic path and its derivatives. The phase grows with time: rad, as a double. */
typedef struct {
    double th;
    real th1;
    real th2;
} Phase;

/* Take-off: down, its rate and its acceleration. */
typedef struct {
    real d;
    real vd;
    real ad;
} Rise;

/* smooth_step */
void smooth_step(real s, real out[3]) {
    if (s <= REAL(0.0) || s >= REAL(1.0)) {
        out[0] = s <= REAL(0.0) ? REAL(0.0) : REAL(1.0);
        out[1] = out[2] = REAL(0.0);
        return;
    }
    real s2 = s * s;
    out[0] = s2 * s * (REAL(10.0) + s * (REAL(-15.0) + REAL(6.0) * s));
    out[1] = REAL(30.0) * s2 * (REAL(1.0) + s * (REAL(-2.0) + s));
    out[2] = REAL(60.0) * s * (REAL(1.0) + s * (REAL(-3.0) + REAL(2.0) * s));
}

/* The share t / T of an interval, for smooth_step: at most 1, so that it fits `real` however long ago the interval was. */
static real share_of(double t, real T) {
    double share = t / (double)T;
    return share >= 1.0 ? REAL(1.0) : (real)share;
}

static void set_point(PathPoint *out, real north, real east, real v_n, real v_e, real a_n, real a_e, Rise rise) {
    out->position[0] = north;
    out->position[1] = east;
    out->position[2] = rise.d;
    out->velocity[0] = v_n;
    out->velocity[1] = v_e;
    out->velocity[2] = rise.vd;
    out->acceleration[0] = a_n;
    out->acceleration[1] = a_e;
    out->acceleration[2] = rise.ad;
}

/* _phase: the rate rises from 0 to omega over ramp_s along a smooth step */
static Phase phase_of(double t, real omega, real ramp_s) {
    if (ramp_s <= REAL(0.0)) {
        return (Phase){(double)omega * t, omega, REAL(0.0)};
    }
    real s = share_of(t, ramp_s), step[3];
    if (s >= REAL(1.0)) {
        return (Phase){(double)omega * (t - 0.5 * (double)ramp_s), omega, REAL(0.0)};
    }
    smooth_step(s, step);
    real s4 = (s * s) * (s * s);
    real integral = s4 * (REAL(2.5) + s * (REAL(-3.0) + s));
    return (Phase){(double)(omega * ramp_s * integral), omega * step[0], omega * step[1] / ramp_s};
}

/* _figure8: lemniscate of Gerono, north A sin(theta), east B/2 sin(2 theta) */
static void figure8(const Figure8 *path, double theta, Phase phase, Rise rise, PathPoint *out) {
    real A = REAL(0.5) * path->length_m, B = REAL(0.5) * path->width_m;
    real th = angle_within_turn(theta + phase.th), th1 = phase.th1, th2 = phase.th2;
    real s = real_sin(th), c = real_cos(th);
    real s2 = real_sin(REAL(2.0) * th), c2 = real_cos(REAL(2.0) * th);
    real a_e = B * (REAL(2.0) * c2 * th2 - REAL(4.0) * s2 * th1 * th1);
    set_point(out, A * s, B * s2, A * c * th1, REAL(2.0) * B * c2 * th1, A * (c * th2 - s * th1 * th1), a_e, rise);
}

/* _circle: through the take-off point, its centre to the north */
static void circle(const Circle *path, double theta, Phase phase, Rise rise, PathPoint *out) {
    real R = path->radius_m;
    real th = angle_within_turn(theta + phase.th), th1 = phase.th1, th2 = phase.th2;
    real s = real_sin(th), c = real_cos(th);
    set_point(out, R * (REAL(1.0) - c), R * s, R * s * th1, R * c * th1, R * (s * th2 + c * th1 * th1),
              R * (c * th2 - s * th1 * th1), rise);
}

/* _approach: moved by what is left of the way to the path's beginning; it shrinks to 0 over ramp_s smoothly */
static void approach(PathPoint *point, const real begin[2], double t, real ramp_s) {
    real step[3];
    smooth_step(share_of(t, ramp_s), step);
    real left = REAL(1.0) - step[0], rise = step[1] / ramp_s, change = step[2] / (ramp_s * ramp_s);
    for (int i = 0; i < 2; i++) {
        point->position[i] -= left * begin[i];
        point->velocity[i] += rise * begin[i];
        point->acceleration[i] += change * begin[i];
    }
}

/* _swing: position, velocity and acceleration along one axis; the amplitude grows over ramp_s along a smooth step */
static void swing(const Swing *motion, double t, real ramp_s, real out[3]) {
    real A = motion->amplitude_m, omega = motion->omega_rad_s;
    real angle = angle_within_turn((double)omega * t + (double)motion->phase_rad), step[3];
    real p = A * real_sin(angle), v = A * omega * real_cos(angle);
    smooth_step(share_of(t, ramp_s), step);
    real share = step[0], rise = step[1] / ramp_s, change = step[2] / (ramp_s * ramp_s);
    out[0] = share * p;
    out[1] = rise * p + share * v;
    out[2] = change * p + REAL(2.0) * rise * v - share * omega * omega * p;
}

/* _legs */
static int32_t make_legs(const Waypoints *path, Leg *legs) {
    real t = REAL(0.0), here[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    for (int i = 0; i < path->points_m_count; i++) {
        Leg *leg = legs + i;
        vector_copy(here, leg->origin);
        vector_subtract(path->points_m[i], here, leg->step);
        leg->start_s = t;
        leg->moving_s = real_max(vector_length(leg->step) / path->speed_m_s, REAL(0.1));
        t += leg->moving_s + path->wait_s;
        vector_copy(path->points_m[i], here);
    }
    return path->points_m_count;
}

/* _along_legs */
static void along_legs(const Path *self, double t, Rise rise, PathPoint *out) {
    int index = self->leg_count - 1;
    while (index > 0 && t < (double)self->legs[index].start_s) {
        index--;
    }
    const Leg *leg = self->legs + index;
    real step[3];
    smooth_step(share_of(t - (double)leg->start_s, leg->moving_s), step);
    real first = step[1] / leg->moving_s, second = step[2] / (leg->moving_s * leg->moving_s);
    for (int i = 0; i < 3; i++) {
        out->position[i] = leg->origin[i] + leg->step[i] * step[0];
        out->velocity[i] = leg->step[i] * first;
        out->acceleration[i] = leg->step[i] * second;
    }
    out->position[2] += rise.d;
    out->velocity[2] += rise.vd;
    out->acceleration[2] += rise.ad;
}

/* The point of a path with laps, without the way to its beginning. */
static void on_lap(const Path *self, Phase phase, Rise rise, PathPoint *out) {
    if (self->config.path.kind == PATH_FIGURE8) {
        figure8(&self->config.path.figure8, (double)self->theta, phase, rise, out);
    } else {
        circle(&self->config.path.circle, (double)self->theta, phase, rise, out);
    }
}

/* Path._begin_of_path */
static void find_begin(Path *self) {
    self->begins_elsewhere = self->theta != REAL(0.0);
    if (self->begins_elsewhere) {
        PathPoint still;
        on_lap(self, (Phase){0.0, REAL(0.0), REAL(0.0)}, (Rise){REAL(0.0), REAL(0.0), REAL(0.0)}, &still);
        self->begin[0] = still.position[0];
        self->begin[1] = still.position[1];
    }
}

/* Path.__init__ */
void path_init(Path *self, const TrajectoryConfig *config, const Swing *lissajous) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->lissajous[0] = lissajous[0];
    self->lissajous[1] = lissajous[1];
    self->start_s = (double)config->takeoff_s + (double)config->settle_s;
    if (config->path.kind == PATH_WAYPOINTS) {
        self->leg_count = make_legs(&config->path.waypoints, self->legs);
    }
    if (config->path.kind == PATH_FIGURE8 || config->path.kind == PATH_CIRCLE) {
        bool eight = config->path.kind == PATH_FIGURE8;
        real start_phase = eight ? config->path.figure8.start_phase : config->path.circle.start_phase;
        self->omega = REAL(2.0) * REAL_PI / path_lap_s(self);
        self->theta = REAL(2.0) * REAL_PI * start_phase;
        find_begin(self);
    }
}

/* Path.laps_from_s */
double path_laps_from_s(const Path *self) {
    return self->start_s + (double)self->config.ramp_s;
}

/* Path.lap_s */
real path_lap_s(const Path *self) {
    switch (self->config.path.kind) {
        case PATH_FIGURE8:
            return self->config.path.figure8.period_s;
        case PATH_CIRCLE:
            return self->config.path.circle.period_s;
        default:
            return REAL(0.0);
    }
}

/* Path.lap_phase */
double path_lap_phase(const Path *self, double t) {
    double since = t - path_laps_from_s(self), lap_s = (double)path_lap_s(self);
    if (!(lap_s > 0.0 && since >= 0.0)) {
        return -1.0;
    }
    double laps = since / lap_s;
    return laps - (double)(int64_t)laps;
}

/* Path._rise */
static Rise rise_at(const Path *self, double t) {
    real height = self->config.altitude_m, takeoff_s = self->config.takeoff_s, step[3];
    if (t >= (double)takeoff_s) {
        return (Rise){-height, REAL(0.0), REAL(0.0)};
    }
    smooth_step((real)(t / (double)takeoff_s), step);
    return (Rise){-height * step[0], -height * step[1] / takeoff_s, -height * step[2] / (takeoff_s * takeoff_s)};
}

/* Path.at */
void path_at(const Path *self, double t, PathPoint *out) {
    Rise rise = rise_at(self, t);
    double since = t - self->start_s;
    real ramp_s = self->config.ramp_s, north[3], east[3];
    TrajectoryPathKind kind = since > 0.0 ? self->config.path.kind : PATH_HOVER;
    switch (kind) {
        case PATH_FIGURE8:
        case PATH_CIRCLE:
            on_lap(self, phase_of(since, self->omega, ramp_s), rise, out);
            if (self->begins_elsewhere) {
                approach(out, self->begin, since, ramp_s);
            }
            break;
        case PATH_LISSAJOUS:
            swing(self->lissajous, since, ramp_s, north);
            swing(self->lissajous + 1, since, ramp_s, east);
            set_point(out, north[0], east[0], north[1], east[1], north[2], east[2], rise);
            break;
        case PATH_WAYPOINTS:
            along_legs(self, since, rise, out);
            break;
        case PATH_HOVER:
            set_point(out, REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0), rise);
            break;
    }
}

/* PathClock.__init__ */
void path_clock_init(PathClock *self) {
    *self = (PathClock){REAL(1.0), REAL(0.5), REAL(1.0), 0.0, REAL(1.0), REAL(0.0)};
}

/* PathClock.step */
void path_clock_step(PathClock *self, bool run, double dt) {
    real target = run ? REAL(1.0) : REAL(0.0);
    real move = (real)dt / self->ease_s, step[3];
    self->x = target > self->x ? real_min(self->x + move, target) : real_max(self->x - move, target);
    smooth_step(self->x, step);
    bool moving = self->x != target;
    self->rate = step[0];
    self->rate_change = moving ? step[1] / self->ease_s * (run ? REAL(1.0) : REAL(-1.0)) : REAL(0.0);
    self->time_s += (double)step[0] * dt;
}

/* PathClock.steady */
bool path_clock_steady(const PathClock *self) {
    return self->rate == REAL(1.0) && self->rate_change == REAL(0.0);
}

/* PathClock.ahead */
void path_clock_ahead(const PathClock *self, PathPoint *point) {
    real r = self->rate, r1 = self->rate_change;
    for (int i = 0; i < 3; i++) {
        real v = point->velocity[i];
        point->velocity[i] = r * v;
        point->acceleration[i] = r * r * point->acceleration[i] + r1 * v;
    }
}
