/* The slope of a map theta'Phi, and its bound by the loop's own gains. The twin of onboard/control/slope.py, which explains
 * it. */
#ifndef DMRAC_SLOPE_H
#define DMRAC_SLOPE_H

#include "control/features.h"

/* Kinds of input: angles, rates, place, motion, motion in body axes. */
#define LOOP_GAIN_GROUPS 5

/* What one axis of a channel's demand changes with the state, by the loop itself, per kind of input. */
typedef struct {
    int32_t groups;
    int32_t first[LOOP_GAIN_GROUPS]; /* signal of the first of the kind's three inputs; the others follow it */
    real gain[LOOP_GAIN_GROUPS * 3]; /* of each axis, units of u per unit of the input */
} LoopGains;

/* LoopGains.of: channel 0 position, 1 attitude; the gains of both. */
void loop_gains_of(int32_t channel, const ChannelGains *position, const ChannelGains *attitude, LoopGains *out);

/* The gain [3] of the kind whose first input is this signal. NULL if the channel has none. */
const real *loop_gains_at(const LoopGains *self, Signal first);

/* d(theta'Phi)/dx [3, m] of a network at one signal vector, x the m inputs in their own units. Zero in an input that is
 * clipped. */
void slopes(const Features *features, const real *theta, const real signals[SIGNAL_COUNT], real *slope);

/* Of each axis, the largest slope over the states [n, SIGNAL_COUNT] and the kinds of input, as a share of the loop's gain.
 * The slope over the inputs of a kind is the norm of its row. */
void largest_shares(const Features *features, const real *theta, const LoopGains *gains, const real *states, int32_t n,
                    real shares[3]);

/* theta [k, 3] becomes `theta_n` with the slope of every axis at these states within share_max. An axis with too steep a map
 * is flattened about its mean over the states, whose features are Phi [k, n]. */
void bounded_theta(const Features *features, const real *theta_n, const LoopGains *gains, real share_max,
                   const real *states, const real *Phi, int32_t n, real *theta);

#endif
