#include "control/feature_reception.h"

#include <string.h>

#include "record/tick.h"

/* FeatureReception.__init__ */
void reception_init(FeatureReception *self) {
    memset(self, 0, sizeof *self);
    self->swapped_ns = NEVER_NS;
}

/* FeatureReception.restart */
void reception_restart(FeatureReception *self) {
    self->refused_version = 0;
    self->refusal = REFUSAL_NONE;
}

/* FeatureReception.conclude */
static void conclude(FeatureReception *self, const VersionOutcome *outcome, int64_t now_ns) {
    if (outcome->refusal != REFUSAL_NONE) {
        self->refusals++;
        self->refused_version = outcome->version;
        self->refusal = outcome->refusal;
        return;
    }
    self->version = outcome->version;
    self->swapped_ns = now_ns;
    self->swaps++;
}

/* FeatureReception.swap */
void reception_swap(FeatureReception *self, Cascade *controller, const FeatureSet *features, int64_t now_ns,
                    VersionOutcome *outcome) {
    *outcome = (VersionOutcome){.offered = features != NULL};
    if (features) {
        outcome->version = features->version;
        outcome->parent = features->parent;
        outcome->samples = features->samples;
        outcome->refusal = cascade_offer_features(controller, features);
        conclude(self, outcome, now_ns);
    }
}

/* FeatureReception.age_s */
double reception_age_s(const FeatureReception *self, int64_t now_ns) {
    return age_s(now_ns, self->swapped_ns);
}
