/* Whole numbers of 64 bits that end at the limits of their type, where Python's have none. */
#ifndef DMRAC_WHOLE_H
#define DMRAC_WHOLE_H

#include <stdint.h>

#include "numerics/real.h"

/* a + b and a - b, or the nearest number that there is. */
int64_t whole_sum(int64_t a, int64_t b);
int64_t whole_difference(int64_t a, int64_t b);
/* |a - b|, which always fits. */
uint64_t whole_distance(int64_t a, int64_t b);
/* (a + b) / 2, rounded down; the sum may be larger than the type. */
int64_t whole_mean(int64_t a, int64_t b);
/* a / b, rounded down; b is positive. */
int64_t whole_floor_divide(int64_t a, int64_t b);
int64_t whole_min(int64_t a, int64_t b);
int64_t whole_max(int64_t a, int64_t b);

/* A configured time in ns, rounded down and to the nearest, as Python's int and round. The float core takes the number of
 * whole microseconds that the time was written with: a float itself is some ns away from 0.1 s, and what happens once in
 * 0.1 s would happen a tick late. */
int64_t nanoseconds_below(real seconds);
int64_t nanoseconds_nearest(real seconds);

#endif
