/* The watch over one channel: the law that learns against the bias-only law, which is computed beside it all the time. The
 * twin of onboard/control/watch.py, which explains it.
 *
 *     d_dot = lambda (r - d), less gamma e'PB while the bias-only law flies;  compared: the misfit, and e */
#ifndef DMRAC_WATCH_H
#define DMRAC_WATCH_H

#include "control/laws/last_layer.h"
#include "control/laws/law.h"

/* Comparisons whose effect has not come yet: the longest lag, 1 s, at the shortest tick, 1 ms. With still shorter ones the
 * oldest is taken before its time. */
#define SENT_MAX 256

/* Why a law is worse than another. */
typedef enum { WATCH_NO_WORSE, WATCH_MISFIT, WATCH_TRIAL, WATCH_MODEL_ERROR } WatchFinding;

typedef struct {
    WatchConfig config;
    int32_t channel; /* 0, 1 */
    real K_1[3];
    real K_2[3];
    real rate;     /* lambda, 1/s */
    real tracking; /* gamma */
    TrackingWeights PB;
    real d[3];                    /* nu of the bias-only law, units of u */
    real sent_map[SENT_MAX * 3];  /* a ring: nu of the law that learns, as commanded */
    real sent_bias[SENT_MAX * 3]; /* d at that time */
    int32_t sent_first;
    int32_t sent_count;
    int64_t ticks;
    real since_s;
    real delta_1[3]; /* e of the other law less e, first half */
    real delta_2[3];
    real misfits[3]; /* mean squares: the map, the bias-only law, none */
    real errors[2];  /* the same of the weighted e: the map, the bias-only law */
    real worse_s;
    real evidence_s; /* time in which the two laws disagreed */
    real agreed_s;   /* time in which they did not */
    real trial[2];   /* mean squared misfits of the map and of the bias-only law, over trial_s of evidence */
    real gain;       /* sum over it of the bias-only law's squared misfit less the map's */
} ChannelWatch;

/* channel: 0, 1. lambda and gamma of the law, PB of its tracking term. */
void watch_init(ChannelWatch *self, const WatchConfig *config, int32_t channel, const ChannelGains *gains, real lambda,
                real gamma, const TrackingWeights *PB);

/* The bias to zero: on the ground. */
void watch_reset(ChannelWatch *self);

/* Another law flies, or another version: forget what was measured of the one before. */
void watch_restart(ChannelWatch *self);

/* One tick. Delta_hat: the filtered residual. now, commanded: nu of the law that learns, at the present and as it would be
 * commanded. level: 0 the map flies, 1 the bias-only law, 2 none. */
void watch_step(ChannelWatch *self, const ChannelState *channel, const real Delta_hat[3], const real now[3],
                const real commanded[3], int32_t level);

/* Why law `one` is worse than law `other` now. 0 the map, 1 the bias-only law, 2 none. */
WatchFinding watch_worse(const ChannelWatch *self, int32_t one, int32_t other);

/* Whether so much evidence says that the map is worse than the bias. */
bool watch_loses(const ChannelWatch *self, real evidence_s);

/* Whether the law that flies has been worse than the next simpler one for too long. */
bool watch_failed(const ChannelWatch *self);

/* Whether so much evidence says that the map is no worse than the bias. */
bool watch_stands(const ChannelWatch *self, real evidence_s);

/* RMS misfit of the map and of the bias-only law, and weighted e of both, units of u. */
void watch_numbers(const ChannelWatch *self, real numbers[4]);

#endif
