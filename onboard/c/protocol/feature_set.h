/* A version of the learnt features: the twin of FeatureSet in protocol/feature_set.py. */
#ifndef DMRAC_FEATURE_SET_H
#define DMRAC_FEATURE_SET_H

#include "control/features.h"

/* One trained version, for one or both channels. */
typedef struct {
    uint32_t version; /* from 1, increasing; 0 is reserved for the random start features */
    uint32_t parent;  /* the version it was trained from; 0 for none */
    uint64_t samples; /* number of samples that it was trained on */
    bool covers[2];   /* position and attitude channel */
    ChannelFeatures by_channel[2];
} FeatureSet;

#endif
