#include "control/feature_reception.h"

#include <string.h>

#include "record/tick.h"

/* FeatureReception.__init__ */
void reception_init(FeatureReception *self) {
    memset(self, 0, sizeof *self);
    receiver_init(&self->receiver);
    self->swapped_ns = NEVER_NS;
}

/* FeatureReception.receive */
void reception_receive(FeatureReception *self, const FeatureChunk *chunk) {
    self->waits = receiver_receive(&self->receiver, chunk, &self->complete) || self->waits;
}

/* FeatureReception.restart */
void reception_restart(FeatureReception *self) {
    receiver_reset(&self->receiver);
    self->waits = false;
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

/* FeatureReception._fall_back: the guard has taken a version back, or lets one fly again */
static void follow(FeatureReception *self, const Fall *fall, int64_t now_ns) {
    if (fall->refused != 0) {
        self->taken_back++;
        self->refused_version = fall->refused;
        self->refusal = REFUSAL_PROBATION;
    }
    if (fall->flying != self->version) {
        self->version = fall->flying;
        self->swapped_ns = fall->flying != 0 ? now_ns : NEVER_NS;
    }
}

/* FeatureReception.swap */
void reception_swap(FeatureReception *self, Cascade *controller, int64_t now_ns, VersionOutcome *outcome) {
    const FeatureSet *features = &self->complete;
    memset(outcome, 0, sizeof *outcome);
    outcome->offered = self->waits;
    self->waits = false;
    if (outcome->offered) {
        outcome->version = features->version;
        outcome->parent = features->parent;
        outcome->samples = features->samples;
        outcome->refusal = cascade_offer_features(controller, features);
        conclude(self, outcome, now_ns);
    }
    outcome->fall_count = cascade_take_falls(controller, outcome->falls);
    for (int32_t i = 0; i < outcome->fall_count; i++) {
        follow(self, outcome->falls + i, now_ns);
    }
}

/* FeatureReception.age_s */
double reception_age_s(const FeatureReception *self, int64_t now_ns) {
    return age_s(now_ns, self->swapped_ns);
}

/* FeatureReception.status */
void reception_status(const FeatureReception *self, ReceptionStatus *status) {
    const FeatureReceiver *receiver = &self->receiver;
    bool later = receiver->refused_version > self->refused_version ||
                 (receiver->refused_version == self->refused_version && receiver->refusal > self->refusal);
    memset(status, 0, sizeof *status);
    status->version = self->version;
    status->transfer_version = receiver->transfer_version;
    status->received_chunks_size = receiver_received_chunks(receiver, status->received_chunks);
    status->refused_version = later ? receiver->refused_version : self->refused_version;
    status->refusal = later ? receiver->refusal : self->refusal;
}
