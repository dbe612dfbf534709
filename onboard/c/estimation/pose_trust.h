/* Compares the poses of the motion capture with what the vehicle measures itself, in flight. The twin of
 * onboard/estimation/pose_trust.py, which explains it. */
#ifndef DMRAC_POSE_TRUST_H
#define DMRAC_POSE_TRUST_H

#include <stdbool.h>
#include <stdint.h>

#include "generated/config.h"

/* What the vehicle's own sensors say of the poses. */
typedef struct {
    EstimatorConfig config;
    int64_t fresh_ns;
    int64_t flow_ns;
    int64_t range_ns;
    int64_t pressure_ns;
    real north_m;
    real east_m;
    real north_m_s;
    real east_m_s;
    real range_m;
    real pressure_m;
    real slow_m;
    real fast_m;
    bool drifting; /* the poses were found to drift, and none was used since then */
    bool blind;    /* samples of the IMU were missing since the last pose that was used: no pose is implausible */
} PoseTrust;

void pose_trust_init(PoseTrust *self, const EstimatorConfig *config);

/* Whether a pose is where the vehicle cannot be. innovation: m; turn: rad; rate: rad/s of the vehicle; age_s: since the
 * last pose that was used. */
bool pose_trust_implausible(const PoseTrust *self, const real innovation[3], const real turn[3], const real rate[3],
                            real age_s, int64_t now_ns);

/* Add a jump to a pose. */
void pose_trust_note_jump(PoseTrust *self, const real step[3], real age_s, int64_t now_ns);

/* Add a residual of the flow, m/s along body x and y. */
void pose_trust_note_flow(PoseTrust *self, const real innovation[2], const real rotation[9], int64_t now_ns);

/* Add a position along d that the range gives, and its residual. */
void pose_trust_note_range(PoseTrust *self, real down_m, real innovation_m, int64_t now_ns);

/* Add a residual of the pressure. */
void pose_trust_note_pressure(PoseTrust *self, real innovation_m, int64_t now_ns);

/* Forget all residuals. */
void pose_trust_forget(PoseTrust *self);

/* By how much the poses have moved position (m) and velocity (m/s) away; false if they have not. */
bool pose_trust_drift(PoseTrust *self, const real position[3], const real velocity[3], int64_t now_ns, real moved_m[3],
                      real moved_m_s[3]);

#endif
