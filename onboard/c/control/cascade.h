/* The cascade of all built-in controllers: a position loop and an attitude loop, each with a law. The twin of
 * onboard/control/cascade.py, which explains it.
 *
 *     position:  u = K_r r - K x - nu_ad         -> thrust and attitude command
 *     attitude:  u = K_1 e_R - K_2 (omega - omega_d) + alpha_d - nu_ad -> torque = J u + omega x J omega */
#ifndef DMRAC_CASCADE_H
#define DMRAC_CASCADE_H

#include "control/command_motion.h"
#include "control/demand_limits.h"
#include "control/guard.h"
#include "control/laws/augmentation.h"
#include "control/records.h"
#include "control/reference_model.h"
#include "control/tracking_bound.h"

typedef struct {
    CascadeSettings settings;
    AirframeConfig airframe;
    Augmentation augmentations[2]; /* position and attitude channel, as of all pairs below */
    Guard guard;
    PositionReferenceModel position_model;
    AttitudeReferenceModel attitude_model;
    real k1[3]; /* gains of the position loop */
    real k2[3];
    real a1[3]; /* gains of the attitude loop */
    real a2[3];
    DemandLimits limits;
    TrackingBounds bounds;
    ChannelState channels[2];
    ControlOutput output; /* of the last step */
    real command[3];      /* K_r r of the reference model, m/s^2 */
    real turn_command[3]; /* the same of the attitude, rad/s^2 */
    real limited[3];      /* what the demand's limits took of the position channel's u, m/s^2 */
    CommandMotion motion;
    int32_t resets_seen;
    bool running;
} Cascade;

/* `start`: of both channels, what their laws start with (augmentation_init). */
void cascade_init(Cascade *self, const CascadeSettings *settings, const AirframeConfig *airframe,
                  const ChannelFeatures *start);

/* One tick of both loops; the command is `output`. */
void cascade_step(Cascade *self, const ControlInputs *inputs);

/* Set the reference models to the vehicle's state, integrals and filters to zero. */
void cascade_reset(Cascade *self, const ControlInputs *inputs);

/* Whether a channel has network features. */
bool cascade_accepts_features(const Cascade *self);

/* Start to prepare a swap of the features of both channels, in place of the one that is being prepared. */
void cascade_begin_features(Cascade *self);

/* One part of it; whether it is over. Then REFUSAL_NONE: they are in use. */
bool cascade_advance_features(Cascade *self, const FeatureSet *features, Refusal *refusal);

/* All parts at once. */
Refusal cascade_offer_features(Cascade *self, const FeatureSet *features);

/* What the guard did since the last call: at most FALLS_MAX. Returns their number. */
int32_t cascade_take_falls(Cascade *self, Fall *falls);

#endif
