/* The spectral norm of a layer in whole numbers: q15_layer_norm of features_q15.h. */
#include <string.h>

#include "control/features_q15.h"
#include "control/q15_pairs.h"
#include "numerics/elementary.h"

#ifdef DMRAC_Q15_FEATURES

#define SUM_GUARD_BITS 6   /* of a sum of up to WIDTH_MAX products */
#define DIRECTION_MAX 4000 /* of a vector: no sum of WIDTH_MAX squares exceeds 32 bits */

/* W W' or W'W, whichever is smaller, [n, n], of rows that have one number of fractional bits. */
static void gram_of_layer(const int32_t *rows, const int8_t *bits, int32_t width, int32_t inputs, int32_t *out) {
    int32_t pairs = pairs_for(inputs), n = width <= inputs ? width : inputs, fewest = fewest_bits(bits, width);
    for (int32_t i = 0; i < n; i++) {
        for (int32_t j = 0; j <= i; j++) {
            int32_t sum = 0;
            if (width <= inputs) {
                const int32_t *a = rows + i * pairs, *b = rows + j * pairs;
                sum = dot_of_pairs(a, b, pairs) >> (bits[i] + bits[j] - 2 * fewest);
            } else {
                for (int32_t m = 0; m < width; m++) {
                    int32_t product = number_of(rows + m * pairs, i) * number_of(rows + m * pairs, j);
                    sum += product >> (2 * (bits[m] - fewest) + SUM_GUARD_BITS);
                }
            }
            out[i * n + j] = out[j * n + i] = sum;
        }
    }
}

/* Bring a positive semidefinite matrix to a trace of at most 2^15, so that no number of its square exceeds 32 bits. */
static void fit_matrix(const int32_t *sums, int32_t n, int32_t *rows) {
    int32_t pairs = pairs_for(n), shift = 0;
    int64_t trace = 1;
    for (int32_t i = 0; i < n; i++) {
        trace += sums[i * n + i];
    }
    for (; trace > 32000; trace >>= 1) {
        shift++;
    }
    for (int32_t i = 0; i < n; i++) {
        for (int32_t j = 0; j < n; j += 2) {
            int32_t high = j + 1 < n ? sums[i * n + j + 1] >> shift : 0;
            rows[i * pairs + j / 2] = pair_of(sums[i * n + j] >> shift, high);
        }
    }
}

/* out = M v, brought to 16 bits. */
static void turn_vector(const int32_t *rows, int32_t n, const int32_t *v, int32_t *out) {
    int32_t sums[WIDTH_MAX], largest = 1, shift = 0, pairs = pairs_for(n);
    for (int32_t i = 0; i < n; i++) {
        sums[i] = dot_of_pairs(rows + i * pairs, v, pairs);
        int32_t size = sums[i] < 0 ? -sums[i] : sums[i];
        largest = size > largest ? size : largest;
    }
    for (; largest > DIRECTION_MAX; largest >>= 1) {
        shift++;
    }
    for (int32_t i = 0; i < n; i += 2) {
        out[i / 2] = pair_of(shifted(sums[i], shift), i + 1 < n ? shifted(sums[i + 1], shift) : 0);
    }
}

/* The direction of the largest singular value, in pairs: of W's inputs or outputs, whichever are fewer. */
static void main_direction(const int32_t *rows, const int8_t *bits, int32_t width, int32_t inputs, int32_t *sums,
                           int32_t *v) {
    int32_t n = width <= inputs ? width : inputs, pairs = pairs_for(n), best = 0;
    int32_t power[WIDTH_MAX * PAIRS_MAX], before[PAIRS_MAX];
    gram_of_layer(rows, bits, width, inputs, sums);
    fit_matrix(sums, n, power);
    for (int step = 0; step < NORM_SQUARINGS; step++) {
        for (int32_t i = 0; i < n; i++) {
            for (int32_t j = 0; j <= i; j++) {
                sums[i * n + j] = sums[j * n + i] = dot_of_pairs(power + i * pairs, power + j * pairs, pairs);
            }
        }
        fit_matrix(sums, n, power);
    }
    for (int32_t i = 1; i < n; i++) {
        best = number_of(power + i * pairs, i) > number_of(power + best * pairs, best) ? i : best;
    }
    memcpy(v, power + best * pairs, (size_t)pairs * sizeof *v);
    for (int step = 0; step < NORM_STEPS; step++) {
        memcpy(before, v, (size_t)pairs * sizeof *v);
        turn_vector(power, n, before, v);
    }
}

real q15_layer_norm(const Features *self, int32_t layer, NormWorkspace *work) {
    Place at = place_of(&self->network, self->selection.count, layer);
    const int32_t *rows = self->whole.pairs + at.pair;
    const int8_t *bits = self->whole.bits + at.row;
    int32_t width = self->network.width[layer], pairs = pairs_for(at.inputs), v[PAIRS_MAX], x[PAIRS_MAX];
    main_direction(rows, bits, width, at.inputs, work->whole, v);
    if (width <= at.inputs) { /* v is a direction of the outputs: W'v is one of the inputs */
        real sums[WIDTH_MAX], largest = REAL(0.0);
        for (int32_t j = 0; j < at.inputs; j++) {
            int64_t sum = 0;
            for (int32_t i = 0; i < width; i++) {
                sum += ((int64_t)number_of(rows + i * pairs, j) * number_of(v, i)) >> bits[i];
            }
            sums[j] = (real)sum;
            largest = real_max(largest, real_abs(sums[j]));
        }
        real scale = largest > REAL(0.0) ? (real)DIRECTION_MAX / largest : REAL(0.0);
        for (int32_t j = 0; j < at.inputs; j += 2) {
            x[j / 2] = pair_of(rounded(sums[j] * scale), j + 1 < at.inputs ? rounded(sums[j + 1] * scale) : 0);
        }
    } else {
        memcpy(x, v, sizeof v);
    }
    real of_v = (real)dot_of_pairs(x, x, pairs), of_W = REAL(0.0);
    for (int32_t i = 0; i < width; i++) {
        real y = (real)dot_of_pairs(rows + i * pairs, x, pairs) / (real)((int32_t)1 << bits[i]);
        of_W += y * y;
    }
    return of_v > REAL(0.0) ? real_sqrt(of_W / of_v) : REAL(0.0);
}

#else

typedef int spectral_norms_in_real_numbers; /* ISO C forbids an empty file */

#endif
