/* What became of the feature versions that arrived: in use, or refused and why. The twin of
 * onboard/control/feature_reception.py, but for the chunks that a version arrives in, which are put together outside. */
#ifndef DMRAC_FEATURE_RECEPTION_H
#define DMRAC_FEATURE_RECEPTION_H

#include "control/cascade.h"

/* What a tick did with a version that waited. */
typedef struct {
    bool offered; /* whether there was one */
    int64_t version;
    int64_t parent;
    int64_t samples;
    Refusal refusal; /* REFUSAL_NONE: it is in use */
} VersionOutcome;

typedef struct {
    int64_t version;         /* in use; 0 for the start features */
    int64_t swapped_ns;      /* NEVER_NS for the start features */
    int64_t refused_version; /* the newest; 0 for none */
    Refusal refusal;
    int32_t swaps;
    int32_t refusals;
    int32_t taken_back; /* versions that flew and were taken back */
} FeatureReception;

void reception_init(FeatureReception *self);

/* Start over for a new session of the peer: its versions may count from 1 again. */
void reception_restart(FeatureReception *self);

/* Offer a complete version to the controller; null if none waits. */
void reception_swap(FeatureReception *self, Cascade *controller, const FeatureSet *features, int64_t now_ns,
                    VersionOutcome *outcome);

/* Time since the features in use were swapped in, s; -1 for the start features. */
double reception_age_s(const FeatureReception *self, int64_t now_ns);

#endif
