/* Numbers of 16 bits in pairs, for the networks in whole numbers (features_q15.h) and their norms (spectral_q15.c). */
#ifndef DMRAC_Q15_PAIRS_H
#define DMRAC_Q15_PAIRS_H

#include "control/features_q15.h"
#include "numerics/elementary.h"

#ifndef DMRAC_DECLARATIONS /* what Python reads (onboard/c/compile.py) has no inline functions */

#define OUTPUT_BITS 15
#define INPUT_BITS 13
#define SIZE_MAX_Q 32766
#define SUM_MAX_Q 64800 /* of the sizes of a row's numbers: with 16-bit inputs no sum exceeds 32 bits */

/* Two numbers of 16 bits in one of 32, so that a processor loads both at once. */
static inline int32_t pair_of(int32_t low, int32_t high) {
    return (int32_t)(((uint32_t)high << 16) | ((uint32_t)low & 0xffff));
}

static inline int32_t low_of(int32_t pair) {
    return (int16_t)pair;
}

static inline int32_t high_of(int32_t pair) {
    return pair >> 16;
}

static inline int32_t number_of(const int32_t *pairs, int32_t i) {
    return i % 2 == 0 ? low_of(pairs[i / 2]) : high_of(pairs[i / 2]);
}

static inline int32_t dot_of_pairs(const int32_t *a, const int32_t *b, int32_t pairs) {
    int32_t sum = 0;
    for (; pairs >= 4; pairs -= 4, a += 4, b += 4) {
        sum += low_of(a[0]) * low_of(b[0]);
        sum += high_of(a[0]) * high_of(b[0]);
        sum += low_of(a[1]) * low_of(b[1]);
        sum += high_of(a[1]) * high_of(b[1]);
        sum += low_of(a[2]) * low_of(b[2]);
        sum += high_of(a[2]) * high_of(b[2]);
        sum += low_of(a[3]) * low_of(b[3]);
        sum += high_of(a[3]) * high_of(b[3]);
    }
    for (; pairs > 0; pairs--, a++, b++) {
        sum += low_of(*a) * low_of(*b);
        sum += high_of(*a) * high_of(*b);
    }
    return sum;
}

/* Products of a row with three vectors, `apart` from each other. */
static inline void three_dots_of_pairs(const int32_t *row, const int32_t *x, int32_t apart, int32_t pairs,
                                       int32_t sums[3]) {
    int32_t a = 0, b = 0, c = 0;
    for (; pairs >= 2; pairs -= 2, row += 2, x += 2) {
        int32_t v = row[0], w = row[1];
        a += low_of(v) * low_of(x[0]);
        a += high_of(v) * high_of(x[0]);
        b += low_of(v) * low_of(x[apart]);
        b += high_of(v) * high_of(x[apart]);
        c += low_of(v) * low_of(x[2 * apart]);
        c += high_of(v) * high_of(x[2 * apart]);
        a += low_of(w) * low_of(x[1]);
        a += high_of(w) * high_of(x[1]);
        b += low_of(w) * low_of(x[apart + 1]);
        b += high_of(w) * high_of(x[apart + 1]);
        c += low_of(w) * low_of(x[2 * apart + 1]);
        c += high_of(w) * high_of(x[2 * apart + 1]);
    }
    if (pairs > 0) {
        a += low_of(row[0]) * low_of(x[0]);
        a += high_of(row[0]) * high_of(x[0]);
        b += low_of(row[0]) * low_of(x[apart]);
        b += high_of(row[0]) * high_of(x[apart]);
        c += low_of(row[0]) * low_of(x[2 * apart]);
        c += high_of(row[0]) * high_of(x[2 * apart]);
    }
    sums[0] = a;
    sums[1] = b;
    sums[2] = c;
}

static inline int32_t pairs_for(int32_t numbers) {
    return (numbers + 1) / 2;
}

/* x / 2^shift, rounded; a negative shift multiplies, up to the largest number. */
static inline int32_t shifted(int32_t x, int32_t shift) {
    if (shift > 0) {
        return shift > 31 ? 0 : ((x >> (shift - 1)) + 1) >> 1;
    }
    int32_t most = INT32_MAX >> -shift;
    return x > most ? INT32_MAX : x < -most ? -INT32_MAX : x * (int32_t)(1U << -shift);
}

/* Where a layer begins. */
typedef struct {
    int32_t parameters; /* in Network */
    int32_t row;        /* in the biases and bits */
    int32_t pair;       /* in the pairs */
    int32_t inputs;
} Place;

/* Outputs of a layer, in pairs, of `below` with so many fractional bits; scaled inputs, rounded, in pairs. */
void q15_evaluate_layer(const WholeNetwork *self, const Place *at, int32_t width, const int32_t *below,
                        int32_t below_bits, int32_t *above);
void q15_round_inputs(const Features *self, const real *z, int32_t *pairs);

static inline Place place_of(const Network *network, int32_t inputs, int32_t layer) {
    Place place = {0, 0, 0, inputs};
    for (int32_t l = 0; l < layer; l++) {
        place.parameters += network->width[l] * (place.inputs + 1);
        place.row += network->width[l];
        place.pair += network->width[l] * pairs_for(place.inputs);
        place.inputs = network->width[l];
    }
    return place;
}

static inline int32_t rounded(real x) {
    return (int32_t)(x < REAL(0.0) ? x - REAL(0.5) : x + REAL(0.5));
}

static inline int32_t fewest_bits(const int8_t *bits, int32_t count) {
    int32_t fewest = OUTPUT_BITS;
    for (int32_t i = 0; i < count; i++) {
        fewest = bits[i] < fewest ? bits[i] : fewest;
    }
    return fewest;
}

#endif

#endif
