/* The test of a map before it flies, on the states of the last second and on a box around the path ahead. The twin of
 * onboard/control/version_test.py, which explains it. */
#ifndef DMRAC_VERSION_TEST_H
#define DMRAC_VERSION_TEST_H

#include "control/features.h"
#include "control/slope.h"

/* What the last test found. Those of the slopes are shares of their limits, the last one of what is allowed. */
typedef struct {
    real bound;  /* norm(theta) norm(Phi), units of u */
    real spread; /* largest change of the map from here, units of u */
    real along;  /* slope along the path */
    real over;   /* slope over the states */
    real misfit; /* over the last second */
} VersionFindings;

/* A map at the recent states; zero before the first one. */
typedef struct {
    int32_t count;
    real low[3]; /* the least and the largest nu of each axis */
    real high[3];
    real misfit; /* sum of squares of nu less the residual */
    real size;   /* of the residual */
} RecentMap;

/* A map on the path and the box ahead, in parts. */
typedef struct {
    real now[SIGNAL_COUNT]; /* where it begins: the states are on the line ahead from here on, then in the box */
    real apart;             /* two states on the line, m */
    real here[3];           /* nu at the first state */
    real last[3];           /* and at the last one seen */
    real low[3];            /* the least and the largest of each axis */
    real high[3];
    real steps[3]; /* the largest change from one state of the path to the next */
    int32_t seen;
    int32_t sloped; /* states of the box whose slope is known */
    real over;      /* largest slope over the states, share of its limit */
} Ahead;

/* The test of one channel's maps. */
typedef struct {
    VersionTestConfig config;
    int32_t channel; /* 0, 1 */
    SlopeLimits slope_limits;
    real corners[BOX_AXES * BOX_POINTS]; /* of the unit box, [BOX_AXES, BOX_POINTS] */
    Ahead ahead;                         /* of a version that is to fly */
    Ahead look;                          /* of the map that flies */
    bool looks;                          /* whether the map that flies is being checked */
    bool good;                           /* what the last check has found */
    VersionFindings found;
} VersionTest;

void version_test_init(VersionTest *self, const VersionTestConfig *config, int32_t channel, const SlopeLimits *limits);

/* Start at the present state. What `ahead_steepest` has found stays. */
void ahead_begin(Ahead *self, const VersionTest *test, const real now[SIGNAL_COUNT]);

/* State `index` of those ahead: of the line, then of the box. */
void ahead_state(const Ahead *self, const VersionTest *test, int32_t index, real state[SIGNAL_COUNT]);

/* Start with the slopes in the box of the present state. */
void ahead_begin_slopes(Ahead *self, const VersionTest *test, const real now[SIGNAL_COUNT]);

/* The slope of the map at so many states of the box; whether all are done. */
bool ahead_steepest(Ahead *self, const VersionTest *test, const Features *features, const real *theta, int32_t most);

/* The map at so many states; whether all have been seen. */
bool ahead_step(Ahead *self, const VersionTest *test, const Features *features, const real *theta, int32_t most);

/* Add a recent state, with nu there and the residual measured. */
void recent_map_add(RecentMap *self, const real nu[3], const real residual[3]);

/* The refusal, once `ahead` has seen all states. over: the largest slope at the recent states, share of its limit. */
Refusal version_test_verdict(VersionTest *self, const real *theta, int32_t k, const RecentMap *recent, real over);

/* Why a map theta'Phi, theta [k, 3], must not fly; REFUSAL_NONE if it may. now: the present state. recent
 * [n, SIGNAL_COUNT]: those of the last second; residuals [n, 3]: measured there. All parts at once. */
Refusal version_test_refusal(VersionTest *self, const Features *features, const real *theta,
                             const real now[SIGNAL_COUNT], const real *recent, const real *residuals, int32_t n);

/* One part of a check of the map that flies, on what is ahead; whether it was the last one. Then `good` says whether the map
 * is still good. */
bool version_test_look(VersionTest *self, const Features *features, const real *theta, const real now[SIGNAL_COUNT]);

#endif
