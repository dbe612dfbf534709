/* What the library did in its last call, for whoever loads it: the stand-in for the firmware, and a debugger. The
 * firmware does not know it. mambo/fake/wire.py reads the numbers in this order. */
#ifndef DMRAC_MAMBO_VIEW_H
#define DMRAC_MAMBO_VIEW_H

#include "firmware.h"
#include "generated/constants.h"
#include "record/tick.h"

typedef struct {
    int64_t state; /* LibraryState */
    int64_t mode;  /* FlightMode of the core */
    int64_t check; /* ArmingCheck */
    int64_t stage; /* BudgetStage */
    int64_t calls;
    int64_t missed; /* periods without a call */
    int64_t twice;
    int64_t late;
    int64_t over_budget;
    int64_t left_out; /* datagrams of offboard that the budget left out */
    int64_t version;  /* of the features in use */
    int64_t swaps;
    int64_t refusals;
    int64_t taken_back;
    int64_t samples_taken;
    int64_t samples_dropped;
    int64_t samples_repeated;
    int64_t dropped[5];                /* readings, by Dropped */
    int64_t rejected[REJECTION_COUNT]; /* datagrams of offboard, by Rejection */
    double tick[TICK_FIELDS];
} DmracView;

EXPORTED void dmrac_view(DmracView *out);

/* The oldest event that waits, as text; false if there is none. */
EXPORTED int dmrac_take_event(int64_t *time_ns, char text[100]);

/* The text of the fault of a refused configuration; empty if there is none. */
EXPORTED const char *dmrac_fault(void);

#endif
