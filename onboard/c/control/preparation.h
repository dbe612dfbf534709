/* A feature version is prepared in parts, one a tick, before it is swapped in one tick. The twin of
 * onboard/control/preparation.py, which explains it. */
#ifndef DMRAC_PREPARATION_H
#define DMRAC_PREPARATION_H

#include "control/feature_content.h"
#include "control/laws/augmentation.h"
#include "control/posterior_swap.h"
#include "control/version_test.h"

typedef struct {
    bool active;                    /* whether the version has passed what needs no preparation */
    uint8_t content[CONTENT_BYTES]; /* of the version */
    int64_t replaces;               /* number and content of what flies */
    uint8_t replaces_content[CONTENT_BYTES];
    bool changes[2]; /* channels whose features would change */
    bool swaps[2];   /* of them, whose swap is prepared: those of the law with a covariance */
    bool tested;
    int32_t swapping; /* channel whose swap is being prepared; 2: all are */
    int32_t sloping;  /* channel whose slopes in the box are checked; 2: all are */
    int32_t looking;  /* channel for which the states ahead are looked at; 2: all are */
    bool begun;       /* whether the slopes, or the look ahead, of a channel have begun */
    Refusal refusal;
    PosteriorSwap posterior[2];
    Features features[2]; /* of the gradient law */
    SwapPlan plans[2];
    SwapWorkspace work; /* of the gradient law */
} Preparation;

/* Start with the channels whose features would change. laws [2]; learns: which of them take features. */
void preparation_begin(Preparation *self, const FeatureSet *features, const Augmentation *laws, const bool learns[2],
                       bool tested);

/* One part; whether all are done. tests [2]. */
bool preparation_step(Preparation *self, const Augmentation *laws, VersionTest *tests);

/* What is to fly, once all parts are done: `plans`, and the refusal. */
Refusal preparation_plans(Preparation *self, const FeatureSet *features, const Augmentation *laws, VersionTest *tests);

/* The sum of the plans' jumps, as shares of jump_max. */
real preparation_jump(const Preparation *self, const Augmentation *laws);

/* The new features of a channel. */
const Features *preparation_features(const Preparation *self, int32_t channel);

#endif
