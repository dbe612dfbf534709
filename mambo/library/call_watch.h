/* Watches the firmware's calls: too soon, too late, at the wrong rate, and how long the library takes.
 *
 * A call that takes longer than the budget counts; too many of them in the last 200 calls lead to the next stage, which
 * saves work or ends the flight. 2000 calls in a row within the budget lead one stage back, but not from landing. */
#ifndef DMRAC_CALL_WATCH_H
#define DMRAC_CALL_WATCH_H

#include "generated/settings.h"

/* Calls over which rate, gaps and budget are judged. */
#define WATCHED_CALLS 200
#define CALM_CALLS 2000

/* What is left out while the library is too slow. */
typedef enum {
    BUDGET_KEPT,
    BUDGET_NO_TRAINING, /* no chunks of features are received, no version is prepared, no samples sent */
    BUDGET_NO_OFFBOARD, /* nothing of offboard is received: without poses the vehicle holds its place */
    BUDGET_LAND
} BudgetStage;

typedef enum { CALL_FIRST, CALL_ON_TIME, CALL_TWICE, CALL_LATE, CALL_TOO_LATE } CallVerdict;

typedef struct {
    BoardWatchdogs config;
    int64_t period_ns;
    bool started;
    int64_t call_ns; /* of the newest call that counts */
    int64_t missed;  /* periods without a call since the start */
    int64_t calls;
    int64_t twice;
    int64_t late;
    int64_t block_ns; /* start of the present block of WATCHED_CALLS */
    int32_t block_calls;
    int64_t block_gap_ns;     /* longest gap in it */
    real rate_hz;             /* of the last block; 0 before its end */
    int64_t gap_ns;           /* longest gap of the last block */
    bool over[WATCHED_CALLS]; /* whether each of the last calls took too long; a ring */
    int32_t at;
    int32_t over_count;
    int32_t calm;
    int64_t over_total;
    int64_t longest_ns;
    BudgetStage stage;
    int64_t stage_ns;
} CallWatch;

void call_watch_init(CallWatch *self, const BoardWatchdogs *config, int64_t period_ns);

/* A call begins. */
CallVerdict call_watch_begin(CallWatch *self, int64_t now_ns);

/* The call ends; whether it led to another stage. */
bool call_watch_end(CallWatch *self, int64_t end_ns);

/* Whether the rate of the last block is outside its limits; false before there is one. */
bool call_watch_wrong_rate(const CallWatch *self);

#endif
