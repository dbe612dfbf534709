#include "ranges.h"

#include <string.h>

#include "protocol/little_endian.h"

static double number_at(const uint8_t *bytes, bool whole) {
    uint64_t bits = read_u64(bytes);
    if (whole) {
        int64_t value;
        memcpy(&value, &bits, sizeof value);
        return (double)value;
    }
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static bool guard_holds(const uint8_t *record, const RangeGuard *guards, int32_t index) {
    while (index >= 0) {
        const RangeGuard *guard = guards + index;
        if (number_at(record + guard->place, true) != (double)guard->value) {
            return false;
        }
        index = guard->parent;
    }
    return true;
}

/* False for NaN, too. */
static bool is_within(const Range *range, double value) {
    bool above = range->low_open ? value > range->low : value >= range->low;
    bool below = range->high_open ? value < range->high : value <= range->high;
    return above && below;
}

const Range *range_fault(const uint8_t *record, const Range *ranges, int32_t count, const RangeGuard *guards,
                         double *value) {
    for (int32_t i = 0; i < count; i++) {
        const Range *range = ranges + i;
        if (!guard_holds(record, guards, range->guard)) {
            continue;
        }
        for (int32_t j = 0; j < range->count; j++) {
            *value = number_at(record + range->place + 8 * j, range->whole != 0);
            if (!is_within(range, *value)) {
                return range;
            }
        }
    }
    return NULL;
}
