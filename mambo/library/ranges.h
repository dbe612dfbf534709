/* What each number of a packed record may be. The tables are written by mambo/ranges.py when the library is built. */
#ifndef DMRAC_RANGES_H
#define DMRAC_RANGES_H

#include <stdbool.h>
#include <stdint.h>

/* A choice on which numbers depend: the whole number at `place` is `value`, and the parent guard holds too. */
typedef struct {
    int32_t place;
    int32_t value;
    int32_t parent; /* -1: none */
} RangeGuard;

/* `count` numbers of 8 bytes, from `place` on. */
typedef struct {
    const char *name;
    double low;
    double high;
    int32_t place;
    int32_t count;
    int32_t guard;     /* judged only if this guard holds; -1: always */
    uint8_t whole;     /* a 64-bit integer and not a double */
    uint8_t low_open;  /* `low` itself is not allowed */
    uint8_t high_open; /* `high` itself is not allowed */
} Range;

extern const RangeGuard core_guards[];
extern const Range core_ranges[];
extern const int32_t core_range_count;
extern const RangeGuard settings_guards[];
extern const Range settings_ranges[];
extern const int32_t settings_range_count;

/* The first range that a record, without its header, does not keep to, and the value; NULL if there is none. */
const Range *range_fault(const uint8_t *record, const Range *ranges, int32_t count, const RangeGuard *guards,
                         double *value);

#endif
