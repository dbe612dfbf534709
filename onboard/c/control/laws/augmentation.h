/* The law of one channel, chosen by its settings. The twin of `_augmentation` in onboard/control/cascade.py, and of
 * Augmentation in onboard/control/laws/law.py. */
#ifndef DMRAC_AUGMENTATION_H
#define DMRAC_AUGMENTATION_H

#include "control/laws/adaptive.h"
#include "control/laws/ilc.h"
#include "control/laws/indi.h"
#include "control/laws/integral.h"
#include "control/laws/l1.h"
#include "control/laws/repetitive.h"

/* Only the law of `kind` is used. */
typedef struct {
    ChannelSettingsAugmentationKind kind;
    Integral integral;
    L1 l1;
    Indi indi;
    Repetitive repetitive;
    IterativeLearning ilc;
    Adaptive adaptive;
} Augmentation;

/* channel: 0 position, 1 attitude. `start`: selection and network of the features that a flight starts with; radial
 * functions use the selection only, other laws nothing. */
void augmentation_init(Augmentation *self, const CascadeSettings *settings, int32_t channel,
                       const ChannelFeatures *start);

/* Estimate Delta: nu_ad [3], units of u. */
void augmentation_step(Augmentation *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]);

/* Reset integrals and filters. What was learnt stays. */
void augmentation_reset(Augmentation *self);

/* Whether the law has features of some kind, and needs to see ahead. */
bool augmentation_has_features(const Augmentation *self);

/* Whether the law reads its map on the path, and not at the state ahead. */
bool augmentation_reads_path(const Augmentation *self);

/* Whether the features may be replaced by trained ones. */
bool augmentation_learns(const Augmentation *self);

#endif
