#include "control/laws/lap_table.h"

#include <string.h>

#include "numerics/elementary.h"

/* LapTable.__init__ */
void lap_table_init(LapTable *self, int32_t bins, real fade_s) {
    memset(self, 0, sizeof *self);
    self->bins = bins;
    self->fade_s = fade_s;
}

/* LapTable.bin */
int32_t lap_table_bin(const LapTable *self, double phase) {
    double share = phase - (double)(int32_t)phase;
    int32_t bin = (int32_t)((share < 0.0 ? share + 1.0 : share) * (double)self->bins);
    return bin < self->bins ? bin : self->bins - 1; /* the rest of a tiny negative phase is rounded to 1 */
}

/* LapTable.follow */
void lap_table_follow(LapTable *self, double phase, real dt) {
    bool repeats = phase >= 0.0;
    if (repeats) {
        self->phase = (real)phase;
    }
    real target = repeats ? REAL(1.0) : REAL(0.0);
    self->share += (REAL(1.0) - real_exp(-dt / self->fade_s)) * (target - self->share);
}

/* LapTable.ahead */
void lap_table_ahead(const LapTable *self, real lead, real nu_ad[3]) {
    real place = (self->phase + lead) * (real)self->bins - REAL(0.5);
    real below = real_floor(place), weight = place - below;
    int32_t bins = self->bins, first = ((int32_t)below % bins + bins) % bins;
    const real *before = self->values + 3 * first, *after = self->values + 3 * ((first + 1) % bins);
    for (int i = 0; i < 3; i++) {
        nu_ad[i] = self->share * ((REAL(1.0) - weight) * before[i] + weight * after[i]);
    }
}

/* LapTable.reset */
void lap_table_reset(LapTable *self) {
    self->share = REAL(0.0);
}
