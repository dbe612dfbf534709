/* From chunks to a complete feature version, and what became of it: in use, or refused and why. The twin of
 * onboard/control/feature_reception.py. */
#ifndef DMRAC_FEATURE_RECEPTION_H
#define DMRAC_FEATURE_RECEPTION_H

#include "control/cascade.h"
#include "protocol/transfer.h"

#define REFUSALS_KEPT 8 /* that wait to be reported; of more the oldest are dropped */
#define REPORTS 3       /* statuses that name a refusal before they name the next one: a status may be lost */

/* What a tick did with a version, and what the guard did. onboard/c/event_text.py makes numpy's texts of it. */
typedef struct {
    bool offered; /* whether a version is in use now, or refused */
    int64_t version;
    int64_t parent;
    int64_t samples;
    Refusal refusal; /* REFUSAL_NONE: it is in use */
    Fall falls[FALLS_MAX];
    int32_t fall_count;
} VersionOutcome;

/* What a tick has time for: all; parts of a version now and then; no version at all. */
typedef enum { SPARE_ALL, SPARE_LITTLE, SPARE_NONE } SpareTime;

/* The feature versions that arrive, and the one in use. */
typedef struct {
    FeatureReceiver receiver;
    FeatureSet complete; /* that waits */
    bool waits;
    FeatureSet preparing; /* the one before it */
    bool prepares;
    bool is_void;                            /* whether that is one of a peer that has restarted */
    bool left_out;                           /* the last tick has left out its part of it */
    int64_t version;                         /* in use; 0 for the start features */
    int64_t swapped_ns;                      /* NEVER_NS for the start features */
    int64_t refused_versions[REFUSALS_KEPT]; /* the first is being reported; the last one stays */
    Refusal reasons[REFUSALS_KEPT];
    int32_t refused_count;
    int32_t reports; /* statuses that have named the first one */
    int32_t swaps;
    int32_t refusals;
    int32_t taken_back; /* versions that flew and were taken back */
} FeatureReception;

/* The reception as the status message reports it. */
typedef struct {
    int64_t version;
    int64_t transfer_version;
    uint8_t received_chunks[BITMAP_BYTES];
    int32_t received_chunks_size; /* bytes of them that are sent */
    int64_t refused_version;
    Refusal refusal;
} ReceptionStatus;

void reception_init(FeatureReception *self);

/* Add one chunk. A version that is complete and valid waits. */
void reception_receive(FeatureReception *self, const FeatureChunk *chunk);

/* Start over for a new session of the peer: its versions may count from 1 again. */
void reception_restart(FeatureReception *self);

/* Go on with the version that the controller prepares, or begin with the one that waits, and take note of what the guard did. A
 * tick with little time leaves out its part, unless the one before has done so; with none a version is refused. */
void reception_swap(FeatureReception *self, Cascade *controller, int64_t now_ns, SpareTime spare,
                    VersionOutcome *outcome);

/* Time since the features in use were swapped in, s; -1 for the start features. */
double reception_age_s(const FeatureReception *self, int64_t now_ns);

/* What the status message says. */
void reception_status(const FeatureReception *self, ReceptionStatus *status);

/* A status was sent: after REPORTS of them the next refusal is named, so that the trainer learns of each. */
void reception_note_status(FeatureReception *self);

#endif
