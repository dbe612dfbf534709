/* The guard: no feature version, and nothing that the adaptation does, may cost the vehicle. The twin of
 * onboard/control/guard.py, which explains it: room, test, probation, proof, audition and memory. It stands between the laws
 * of both channels, which the caller owns, and the loops. */
#ifndef DMRAC_GUARD_H
#define DMRAC_GUARD_H

#include "control/laws/augmentation.h"
#include "control/preparation.h"
#include "control/room.h"
#include "control/watch.h"

/* Falls that wait to be taken; those beyond are lost and counted. */
#define FALLS_MAX 8

/* Contents that are never accepted again. When so many versions have been taken back, no other one is accepted, whatever
 * strikes_max says. */
#define CONTENTS_MAX 64

/* Swaps of the last second that are remembered; one more is too many, whatever swaps_per_s_max says. */
#define SWAPS_MAX 256

/* The law that flies. */
typedef enum { LEVEL_MAP, LEVEL_BIAS, LEVEL_NONE } Level;

typedef enum {
    FALL_BACK,    /* to the last good version */
    FALL_SIMPLER, /* to the next simpler law */
    FALL_UP       /* a version flies after its audition */
} FallKind;

/* Why a law was taken back. */
typedef enum { FALL_MISFIT, FALL_TRIAL, FALL_MODEL_ERROR, FALL_AHEAD, FALL_BEFORE } FallReason;

/* A step back, or up again: for the events, the ground station and the trainer. onboard/c/event_text.py makes numpy's text
 * of it. */
/* Busy ticks in a row that leave out their part of the check. */
#define LOOK_WAITS_MAX 3

typedef struct {
    FallKind kind;
    FallReason reason; /* not of FALL_UP */
    int32_t channel;   /* where the reason was found; not of FALL_BEFORE */
    Level level;       /* the law that flies now */
    int64_t refused;   /* the version taken back; 0 if none is */
    int64_t flying;    /* the version in use now */
} Fall;

/* A version that may be needed again, with all that the laws had learnt with it. */
typedef struct {
    int64_t version;
    uint8_t content[CONTENT_BYTES];
    Learnt learnt[2];
} Kept;

typedef struct {
    GuardConfig config;
    Room room;
    bool learns[2]; /* whether the law of the channel takes features; only those are watched */
    ChannelWatch watches[2];
    VersionTest tests[2];
    Level level;
    int64_t version;
    int64_t limited[2]; /* ticks in which the room was too small, per channel */
    Kept good;
    bool proven;
    uint8_t content[CONTENT_BYTES];
    uint8_t refused[CONTENTS_MAX * CONTENT_BYTES];
    int32_t refused_count;
    int32_t strikes;
    int32_t losses;      /* versions in a row that had lost to the bias when the next one came */
    bool needs_evidence; /* a map that says what the bias says may not fly for that alone */
    Fall falls[FALLS_MAX];
    int32_t fall_count;
    int32_t falls_lost;
    double swap_times_s[SWAPS_MAX]; /* a ring: time of each swap of the last second */
    real swap_jumps[SWAPS_MAX];     /* and its jump, as a share of jump_max */
    int32_t swap_first;
    int32_t swap_count;
    double time_s;
    double next_check_s;
    int32_t waits; /* ticks in a row that have left out their part of the check */
    bool due[2];   /* channels whose map is still to be checked */
    bool adapting;
    Preparation work; /* of the version that is being prepared */
} Guard;

/* augmentations: position and attitude channel, as in all functions below. */
void guard_init(Guard *self, const GuardConfig *config, const Augmentation *augmentations, const ChannelGains *position,
                const ChannelGains *attitude, const AirframeConfig *airframe, real tilt_max_rad);

/* One tick of a channel's law: the nu_ad to command, which is written into the telemetry too. */
void guard_step(Guard *self, Augmentation *augmentations, int32_t channel, const ChannelState *state,
                ChannelTelemetry *telemetry, const ControlInputs *inputs, real nu_ad[3]);

/* Decide, once a tick and after both channels, which law flies from the next tick on. A tick that is busy leaves out its part of
 * the check of what is ahead, up to LOOK_WAITS_MAX in a row. */
void guard_judge(Guard *self, Augmentation *augmentations, real dt, bool adapting, bool busy);

/* Copy the falls since the last call and forget them; returns their number, at most FALLS_MAX. */
int32_t guard_take_falls(Guard *self, Fall *falls);

/* On the ground: what was measured in the air is void. Versions and their W stay. */
void guard_reset(Guard *self);

/* Start to prepare a version, in place of the one that is being prepared. */
void guard_begin(Guard *self);

/* One part of the preparation of `features`, the same in every call: whether it is over. Then REFUSAL_NONE: the version has been
 * swapped in, in both channels. */
bool guard_advance(Guard *self, Augmentation *augmentations, const FeatureSet *features, Refusal *refusal);

/* All parts at once. */
Refusal guard_offer(Guard *self, Augmentation *augmentations, const FeatureSet *features);

#endif
