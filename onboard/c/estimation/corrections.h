/* Gated corrections of the filter, with counts, scores, and the announcement of jumps. The twin of
 * onboard/estimation/corrections.py. */
#ifndef DMRAC_CORRECTIONS_H
#define DMRAC_CORRECTIONS_H

#include "estimation/events.h"
#include "estimation/state.h"
#include "generated/config.h"

typedef struct {
    real jump_threshold_m;
    int64_t recovery_ns;
    int64_t refused_since_ns[AID_COUNT];
    int32_t refused_in_a_row[AID_COUNT];
    EstimatorEvents events;
    int64_t used[AID_COUNT];
    int64_t refused[AID_COUNT];
    int64_t recovered[AID_COUNT];
    real scores[AID_COUNT]; /* newest score of each aid: the squared innovation over its variance */
    bool in_flight;         /* whether scores count in the sums */
    real score_sums[AID_COUNT];
    int64_t score_counts[AID_COUNT];
} Corrections;

void corrections_init(Corrections *self, const EstimatorConfig *config);

/* Store the score of an aid; within its gate and in flight it counts in the mean. */
void corrections_note_score(Corrections *self, Aid aid, real score, real gate, int32_t dimension);

/* Count what became of a correction with this score; a jump since the position `before` is announced. True if it was
 * used. */
bool corrections_conclude(Corrections *self, const ErrorStateFilter *filter, VehicleState *state, Aid aid, real score,
                          real gate, const real before[3], int64_t now_ns);

/* Whether an aid has been refused so long that the state is probably wrong. */
bool corrections_refused_long(const Corrections *self, Aid aid, int64_t now_ns);

/* Increase the uncertainty of some errors, so that the aid will be accepted. */
void corrections_widen(Corrections *self, ErrorStateFilter *filter, Aid aid, int32_t start, int32_t size, real sigma,
                       int64_t now_ns);

/* Announce the correction since the position `before` if it is a jump, or `always`. `yaw`: its turn, rad. */
void corrections_announce_jump(Corrections *self, const ErrorStateFilter *filter, VehicleState *state,
                               const real before[3], Aid cause, int64_t now_ns, real yaw, bool always);

#endif
