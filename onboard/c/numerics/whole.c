#include "numerics/whole.h"

static double written(real seconds) {
#ifdef DMRAC_FLOAT
    return (double)(int64_t)((double)seconds * 1e6 + 0.5) / 1e6;
#else
    return seconds;
#endif
}

int64_t nanoseconds_below(real seconds) {
    return (int64_t)(written(seconds) * 1e9);
}

int64_t nanoseconds_nearest(real seconds) {
    return (int64_t)(written(seconds) * 1e9 + 0.5);
}

int64_t whole_sum(int64_t a, int64_t b) {
    if (b > 0 && a > INT64_MAX - b) {
        return INT64_MAX;
    }
    if (b < 0 && a < INT64_MIN - b) {
        return INT64_MIN;
    }
    return a + b;
}

int64_t whole_difference(int64_t a, int64_t b) {
    if (b < 0 && a > INT64_MAX + b) {
        return INT64_MAX;
    }
    if (b > 0 && a < INT64_MIN + b) {
        return INT64_MIN;
    }
    return a - b;
}

uint64_t whole_distance(int64_t a, int64_t b) {
    return a > b ? (uint64_t)a - (uint64_t)b : (uint64_t)b - (uint64_t)a;
}

int64_t whole_mean(int64_t a, int64_t b) {
    int64_t both_odd = a % 2 != 0 && b % 2 != 0;
    return whole_floor_divide(a, 2) + whole_floor_divide(b, 2) + both_odd;
}

int64_t whole_floor_divide(int64_t a, int64_t b) {
    return a / b - (a % b < 0);
}

int64_t whole_min(int64_t a, int64_t b) {
    return b < a ? b : a;
}

int64_t whole_max(int64_t a, int64_t b) {
    return b > a ? b : a;
}
