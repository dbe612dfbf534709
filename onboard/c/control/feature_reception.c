#include "control/feature_reception.h"

#include <string.h>

#include "record/tick.h"

/* FeatureReception.__init__ */
void reception_init(FeatureReception *self) {
    memset(self, 0, sizeof *self);
    receiver_init(&self->receiver);
    self->swapped_ns = NEVER_NS;
}

static void drop_first_refusal(FeatureReception *self) {
    self->refused_count--;
    memmove(self->refused_versions, self->refused_versions + 1,
            (size_t)self->refused_count * sizeof self->refused_versions[0]);
    memmove(self->reasons, self->reasons + 1, (size_t)self->refused_count * sizeof self->reasons[0]);
}

/* FeatureReception._name_next */
static void name_next(FeatureReception *self) {
    if (self->reports >= REPORTS && self->refused_count > 1) {
        drop_first_refusal(self);
        self->reports = 0;
    }
}

/* FeatureReception._refuse: note a refusal for the status */
static void refuse(FeatureReception *self, int64_t version, Refusal reason) {
    if (self->refused_count == REFUSALS_KEPT) {
        drop_first_refusal(self);
    }
    self->refused_versions[self->refused_count] = version;
    self->reasons[self->refused_count++] = reason;
    name_next(self);
}

/* FeatureReception.receive */
void reception_receive(FeatureReception *self, const FeatureChunk *chunk) {
    FeatureReceiver *receiver = &self->receiver;
    int64_t version = receiver->refused_version;
    Refusal reason = receiver->refusal;
    self->waits = receiver_receive(receiver, chunk, &self->complete) || self->waits;
    if (receiver->refused_version != version || receiver->refusal != reason) {
        refuse(self, receiver->refused_version, receiver->refusal);
    }
}

/* FeatureReception.restart */
void reception_restart(FeatureReception *self) {
    receiver_reset(&self->receiver);
    self->waits = false;
    self->is_void = self->prepares;
    self->refused_count = 0;
    self->reports = 0;
}

/* FeatureReception.conclude */
static void conclude(FeatureReception *self, const VersionOutcome *outcome, int64_t now_ns) {
    if (outcome->refusal != REFUSAL_NONE) {
        self->refusals++;
        refuse(self, outcome->version, outcome->refusal);
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
        refuse(self, fall->refused, REFUSAL_PROBATION);
    }
    if (fall->flying != self->version) {
        self->version = fall->flying;
        self->swapped_ns = fall->flying != 0 ? now_ns : NEVER_NS;
    }
}

/* FeatureReception._prepared: one part of the version that is being prepared; whether it is over */
static bool prepare(FeatureReception *self, Cascade *controller, Refusal *refusal) {
    if (self->is_void) {
        self->prepares = self->is_void = false;
    }
    if (self->prepares) {
        self->prepares = !cascade_advance_features(controller, &self->preparing, refusal);
        return !self->prepares;
    }
    if (self->waits) {
        self->preparing = self->complete;
        self->prepares = true;
        self->waits = false;
        cascade_begin_features(controller);
    }
    return false;
}

/* Refuse the version that is being prepared, or else the one that waits; whether there was one. */
static bool give_up(FeatureReception *self, Refusal *refusal) {
    if (!self->prepares && !self->waits) {
        return false;
    }
    if (!self->prepares) {
        self->preparing = self->complete;
        self->waits = false;
    }
    self->prepares = self->is_void = false;
    *refusal = REFUSAL_NOT_ACCEPTING;
    return true;
}

/* FeatureReception.swap */
void reception_swap(FeatureReception *self, Cascade *controller, int64_t now_ns, SpareTime spare,
                    VersionOutcome *outcome) {
    const FeatureSet *features = &self->preparing;
    memset(outcome, 0, sizeof *outcome);
    self->left_out = spare == SPARE_LITTLE && !self->left_out;
    if (spare == SPARE_NONE) {
        outcome->offered = give_up(self, &outcome->refusal);
    } else if (!self->left_out) {
        outcome->offered = prepare(self, controller, &outcome->refusal);
    }
    if (outcome->offered) {
        outcome->version = features->version;
        outcome->parent = features->parent;
        outcome->samples = features->samples;
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
    memset(status, 0, sizeof *status);
    status->version = self->version;
    status->transfer_version = receiver->transfer_version;
    status->received_chunks_size = receiver_received_chunks(receiver, status->received_chunks);
    status->refused_version = self->refused_count > 0 ? self->refused_versions[0] : 0;
    status->refusal = self->refused_count > 0 ? self->reasons[0] : REFUSAL_NONE;
}

/* FeatureReception.note_status */
void reception_note_status(FeatureReception *self) {
    self->reports += self->refused_count > 0;
    name_next(self);
}
