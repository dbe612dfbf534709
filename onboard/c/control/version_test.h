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

/* The test of one channel's maps. */
typedef struct {
    VersionTestConfig config;
    int32_t channel; /* 0, 1 */
    SlopeLimits slope_limits;
    real corners[BOX_AXES * BOX_POINTS];   /* of the unit box, [BOX_AXES, BOX_POINTS] */
    real path[PATH_POINTS * SIGNAL_COUNT]; /* states on the line ahead, from here on; of the last test */
    real box[BOX_POINTS * SIGNAL_COUNT];   /* states in the box; of the last test */
    VersionFindings found;
} VersionTest;

void version_test_init(VersionTest *self, const VersionTestConfig *config, int32_t channel, const SlopeLimits *limits);

/* Why a map theta'Phi, theta [k, 3], must not fly; REFUSAL_NONE if it may. now: the present state. recent
 * [n, SIGNAL_COUNT]: those of the last second; residuals [n, 3]: measured there. */
Refusal version_test_refusal(VersionTest *self, const Features *features, const real *theta,
                             const real now[SIGNAL_COUNT], const real *recent, const real *residuals, int32_t n);

/* Whether the map that flies passes on the path and the box ahead of here. */
bool version_test_still_good(VersionTest *self, const Features *features, const real *theta,
                             const real now[SIGNAL_COUNT]);

#endif
