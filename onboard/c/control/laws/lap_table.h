/* A table over the lap: one vector for each bin of lap phase. The twin of onboard/control/laws/lap_table.py. */
#ifndef DMRAC_LAP_TABLE_H
#define DMRAC_LAP_TABLE_H

#include <stdint.h>

#include "generated/constants.h"

/* A periodic table of nu_ad over lap phase, read with linear interpolation and faded in and out. */
typedef struct {
    real values[BINS_MAX * 3]; /* [bins, 3], units of u, each at the centre of its bin */
    int32_t bins;
    real fade_s;
    real share;
    real phase;
} LapTable;

/* fade_s: time constant with which the table's share follows whether the path repeats. */
void lap_table_init(LapTable *self, int32_t bins, real fade_s);

/* Index of the bin that holds a lap phase, of any lap. A phase is a double: ticks lie on the edges of the bins, and a float
 * would put some of them into the next one. */
int32_t lap_table_bin(const LapTable *self, double phase);

/* Remember the lap phase; while it is negative, the table's share fades at the last known phase. */
void lap_table_follow(LapTable *self, double phase, real dt);

/* nu_ad of the table, `lead` of a lap after the present phase, times the table's share. */
void lap_table_ahead(const LapTable *self, real lead, real nu_ad[3]);

/* Set the share to zero. What was learnt stays. */
void lap_table_reset(LapTable *self);

#endif
