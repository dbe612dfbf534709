/* The slope of a map theta'Phi, and its limits by the loop's own gains. The twin of onboard/control/slope.py, which explains
 * it. */
#ifndef DMRAC_SLOPE_H
#define DMRAC_SLOPE_H

#include "control/features.h"

/* Kinds of input: angles, rates, place, motion, motion in body axes. */
#define SLOPE_GROUPS 5

/* The largest slope of a map, per kind of input. */
typedef struct {
    int32_t groups;
    int32_t first[SLOPE_GROUPS];  /* signal of the first of the kind's three inputs; the others follow it */
    real limit[SLOPE_GROUPS * 3]; /* of each axis, units of u per unit of the input */
} SlopeLimits;

/* The shares of the loop's own gains. channel: 0 position, 1 attitude; the gains of both. */
void slope_limits_of(int32_t channel, const ChannelGains *position, const ChannelGains *attitude,
                     const SlopeShares *shares, SlopeLimits *out);

/* The limit [3] of the kind whose first input is this signal. NULL if the channel has none. */
const real *slope_limits_at(const SlopeLimits *self, Signal first);

/* d(theta'Phi)/dx [3, m] of a network at one signal vector, x the m inputs in their own units. Zero in an input that is
 * clipped. */
void slopes(const Features *features, const real *theta, const real signals[SIGNAL_COUNT], real *slope);

/* Of each axis, the largest slope over the states [n, SIGNAL_COUNT] and the kinds of input, as a share of its limit. The
 * slope over the inputs of a kind is the norm of its row. */
void largest_shares(const Features *features, const real *theta, const SlopeLimits *limits, const real *states,
                    int32_t n, real shares[3]);

/* Flatten theta [k, 3] and its shares, of `largest_shares`, so that the slope of every axis is within its limit. An axis with
 * too steep a map is flattened about its mean over n states, whose features are Phi [n, FEATURES_MAX]. */
void flattened(real shares[3], const real *Phi, int32_t n, int32_t k, real *theta);

#endif
