#include "numerics/whole.h"

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
